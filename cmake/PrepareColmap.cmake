# Makes a patched copy of a COLMAP source tree in the build folder.
#
#   mfir_prepare_colmap(SOURCE_DIR OUTPUT_DIR)
#
# The copy is made anew when a file of the tree or the patch changes; the given
# tree is never written to (COLMAP 3.8 itself writes util/version.h into its
# source tree, which alone is reason for the copy). Only what COLMAP's build
# reads is copied: an own tree may hold build folders and data.
function(mfir_prepare_colmap source_dir output_dir)
    if(NOT EXISTS "${source_dir}/src/exe/colmap.cc")
        message(FATAL_ERROR
            "MFIR_COLMAP_SOURCE='${source_dir}' is not a COLMAP 3.8 source tree (no src/exe/colmap.cc "
            "in it). Give the folder that contains COLMAP's top CMakeLists.txt, or run scripts/quickstart.sh, "
            "which gets the distribution's source package.")
    endif()
    file(STRINGS "${source_dir}/CMakeLists.txt" version_line REGEX "set\\(COLMAP_VERSION \"[0-9.]+\"\\)")
    string(REGEX REPLACE ".*\"([0-9.]+)\".*" "\\1" version "${version_line}")
    set(patch_file "${CMAKE_SOURCE_DIR}/patches/colmap-${version}.patch")
    if(NOT EXISTS "${patch_file}")
        message(FATAL_ERROR
            "COLMAP ${version} in '${source_dir}' has no patch in patches/. See patches/README.md for the "
            "supported versions and for how to add one.")
    endif()

    file(SHA256 "${patch_file}" patch_hash)
    set(stamp "${source_dir}\n${patch_hash}\n")
    set(parts "${source_dir}/CMakeLists.txt")
    foreach(folder cmake doc lib scripts src)
        if(IS_DIRECTORY "${source_dir}/${folder}")
            list(APPEND parts "${source_dir}/${folder}")
        endif()
    endforeach()
    set(files "${source_dir}/CMakeLists.txt")
    foreach(part ${parts})
        file(GLOB_RECURSE part_files "${part}/*")
        list(APPEND files ${part_files})
    endforeach()
    foreach(file ${files})
        file(TIMESTAMP "${file}" time "%s")
        file(SIZE "${file}" size)
        string(APPEND stamp "${file} ${time} ${size}\n")
    endforeach()
    set(stamp_file "${output_dir}.stamp")
    if(EXISTS "${stamp_file}")
        file(READ "${stamp_file}" old_stamp)
        if(old_stamp STREQUAL stamp)
            return()
        endif()
    endif()

    find_program(PATCH_EXECUTABLE patch REQUIRED)
    file(REMOVE "${stamp_file}")
    file(REMOVE_RECURSE "${output_dir}")
    file(COPY ${parts} DESTINATION "${output_dir}")
    execute_process(
        COMMAND "${PATCH_EXECUTABLE}" --strip=1 --batch --fuzz=0 --input=${patch_file}
        WORKING_DIRECTORY "${output_dir}"
        RESULT_VARIABLE result OUTPUT_VARIABLE output ERROR_VARIABLE output)
    if(NOT result EQUAL 0)
        message(FATAL_ERROR "${patch_file} does not apply to '${source_dir}':\n${output}")
    endif()
    file(WRITE "${stamp_file}" "${stamp}")
    message(STATUS "Patched a copy of COLMAP ${version}")
endfunction()
