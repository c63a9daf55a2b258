// COLMAP's parser of command lines.

#pragma once

#include <string>
#include <vector>

#if MFIR_COLMAP_MAJOR >= 4
#include "colmap/controllers/base_option_manager.h"
#else
#include "util/option_manager.h"
#endif

namespace mfir::host {

// Options are added by AddDefaultOption(name, &value, help).
#if MFIR_COLMAP_MAJOR >= 4
using OptionManager = colmap::BaseOptionManager;
#else
using OptionManager = colmap::OptionManager;
#endif

// COLMAP 4's options of its log; with 3.8 our commands have them, too.
struct LogOptions {
  // "stderr", "stdout", "file" or "stderr_and_file".
  std::string target = "stderr_and_file";
  std::string path;

  bool ToFile() const {
    return target == "file" || target == "stderr_and_file";
  }
};

// Parses "--name value" and "--name=value"; `arguments` has no --project_path.
// With --help: prints the options and exits with 0. Exits with 1 and a line on
// stderr for a value that cannot be read. Throws OutputError for a log_path
// that cannot be made.
LogOptions ParseOptions(const std::vector<std::string>& arguments,
                        OptionManager* manager);

// Names of the options that COLMAP adds to each command.
const std::vector<std::string>& CommonOptionNames();

// For an option of COLMAP that this version does not have, but another one:
// what takes its place here. Empty for all others.
std::string PlaceOfOption(const std::string& name);

}  // namespace mfir::host
