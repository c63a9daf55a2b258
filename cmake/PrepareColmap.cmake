# Makes a copy of a COLMAP source tree in the build folder, with our hook in it.
#
#   mfir_prepare_colmap(SOURCE_DIR OUTPUT_DIR)
#
# The copy is made anew when a file of the tree or of the hook changes; the given
# tree is never written to (COLMAP writes files with its version into its source
# tree, which alone is reason for the copy). Only what COLMAP's build reads is
# copied: an own tree may hold build folders and data. Sets MFIR_COLMAP_VERSION.

# The folder of COLMAP's program below SOURCE_DIR, "" if it is no COLMAP tree.
function(mfir_find_colmap_exe source_dir result)
    set(${result} "" PARENT_SCOPE)
    foreach(folder src/colmap/exe src/exe)
        if(EXISTS "${source_dir}/${folder}/colmap.cc")
            set(${result} ${folder} PARENT_SCOPE)
            return()
        endif()
    endforeach()
endfunction()

# Inserts TEXT after (or before) the only line of FILE that is ANCHOR.
function(mfir_insert file where anchor text)
    file(READ "${file}" content)
    string(FIND "${content}" "\n${anchor}\n" first)
    string(FIND "${content}" "\n${anchor}\n" last REVERSE)
    if(first EQUAL -1 OR NOT first EQUAL last)
        message(FATAL_ERROR
            "The line '${anchor}' must occur once in ${file} for our hook, as in all supported versions "
            "of COLMAP. See patches/README.md for how a version is added.")
    endif()
    if(where STREQUAL "AFTER")
        string(LENGTH "\n${anchor}\n" length)
        math(EXPR position "${first} + ${length}")
    else()
        math(EXPR position "${first} + 1")
    endif()
    string(SUBSTRING "${content}" 0 ${position} before)
    string(SUBSTRING "${content}" ${position} -1 after)
    file(WRITE "${file}" "${before}${text}\n${after}")
endfunction()

# The hook, in the copy: see patches/README.md.
function(mfir_add_hook copy exe_folder)
    string(REGEX REPLACE "^src/" "" include_folder "${exe_folder}")
    set(exe "${copy}/${exe_folder}")
    file(COPY "${CMAKE_SOURCE_DIR}/patches/extension.h" DESTINATION "${exe}")
    mfir_insert("${exe}/colmap.cc" AFTER "#include \"${include_folder}/database.h\""
        "#include \"${include_folder}/extension.h\"")
    mfir_insert("${exe}/colmap.cc" BEFORE "  if (argc == 1) {"
        "  for (const auto& command : colmap::ExtensionCommands()) {
    commands.emplace_back(command.first, command.second);
  }
")
    file(READ "${CMAKE_SOURCE_DIR}/patches/extension.cmake" text)
    file(APPEND "${exe}/CMakeLists.txt" "${text}")
endfunction()

function(mfir_apply_patch copy patch_file)
    find_program(PATCH_EXECUTABLE patch REQUIRED)
    execute_process(
        COMMAND "${PATCH_EXECUTABLE}" --strip=1 --batch --fuzz=0 --input=${patch_file}
        WORKING_DIRECTORY "${copy}"
        RESULT_VARIABLE result OUTPUT_VARIABLE output ERROR_VARIABLE output)
    if(NOT result EQUAL 0)
        message(FATAL_ERROR "${patch_file} does not apply:\n${output}")
    endif()
endfunction()

function(mfir_prepare_colmap source_dir output_dir)
    mfir_find_colmap_exe("${source_dir}" exe_folder)
    if(NOT exe_folder)
        message(FATAL_ERROR
            "MFIR_COLMAP_SOURCE='${source_dir}' is not a COLMAP source tree (no src/exe/colmap.cc or "
            "src/colmap/exe/colmap.cc in it). Give the folder that contains COLMAP's top CMakeLists.txt, or "
            "run scripts/quickstart.sh, which gets the distribution's source package.")
    endif()
    # "4.2.0.dev0" between releases.
    file(STRINGS "${source_dir}/CMakeLists.txt" version_line REGEX "set\\(COLMAP_VERSION \"[0-9.]+")
    string(REGEX REPLACE ".*\"([0-9]+(\\.[0-9]+)*).*" "\\1" version "${version_line}")
    set(MFIR_COLMAP_VERSION "${version}" PARENT_SCOPE)
    # 4.0 has other interfaces of features and bundle adjustment.
    if(NOT (version VERSION_EQUAL 3.8 OR (version VERSION_GREATER_EQUAL 4.1 AND version VERSION_LESS 5)))
        message(FATAL_ERROR
            "COLMAP ${version} in '${source_dir}' is not supported: 3.8, and 4.1 or a later 4.x, are. See "
            "patches/README.md for how a version is added.")
    endif()

    set(patch_file "${CMAKE_SOURCE_DIR}/patches/colmap-${version}.patch")
    set(hook_files "${CMAKE_SOURCE_DIR}/patches/extension.h" "${CMAKE_SOURCE_DIR}/patches/extension.cmake"
        "${CMAKE_SOURCE_DIR}/cmake/PrepareColmap.cmake")
    if(EXISTS "${patch_file}")
        list(APPEND hook_files "${patch_file}")
    endif()
    set(stamp "${source_dir}\n")
    foreach(file ${hook_files})
        file(SHA256 "${file}" hash)
        string(APPEND stamp "${hash}\n")
    endforeach()
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

    file(REMOVE "${stamp_file}")
    file(REMOVE_RECURSE "${output_dir}")
    file(COPY ${parts} DESTINATION "${output_dir}")
    mfir_add_hook("${output_dir}" "${exe_folder}")
    if(EXISTS "${patch_file}")
        mfir_apply_patch("${output_dir}" "${patch_file}")
    endif()
    file(WRITE "${stamp_file}" "${stamp}")
    message(STATUS "Copied COLMAP ${version}, with the hook for our commands")
endfunction()
