# Makes a patched copy of a COLMAP source tree in the build folder.
#
#   mfir_prepare_colmap(SOURCE_DIR OUTPUT_DIR)
#
# The copy is made anew when the source path, its version or the patch changes;
# the given tree is never written to (COLMAP 3.8 itself writes util/version.h
# into its source tree, which alone is reason for the copy).
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
    file(SHA256 "${source_dir}/CMakeLists.txt" source_hash)
    set(stamp "${source_dir}\n${source_hash}\n${patch_hash}\n")
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
    file(COPY "${source_dir}/" DESTINATION "${output_dir}" PATTERN ".git" EXCLUDE)
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
