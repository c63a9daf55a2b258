
# Folders outside of this source tree that register further commands. They put
# OBJECT libraries into the property: from a static library the linker would
# drop the files that do nothing but register.
foreach(EXTENSION_DIR ${COLMAP_EXTENSION_DIRS})
    get_filename_component(EXTENSION_NAME ${EXTENSION_DIR} NAME)
    add_subdirectory(${EXTENSION_DIR} ${CMAKE_BINARY_DIR}/${EXTENSION_NAME})
endforeach()
get_property(EXTENSION_OBJECTS GLOBAL PROPERTY COLMAP_EXTENSION_OBJECTS)
if(TARGET colmap_main)
    target_link_libraries(colmap_main ${EXTENSION_OBJECTS})
else()
    target_link_libraries(colmap_exe ${EXTENSION_OBJECTS})
endif()
