#include "colmap_ext/host/options.h"

#include <algorithm>
#include <cstdlib>

namespace mfir::host {

void ParseOptions(const std::vector<std::string>& arguments,
                  OptionManager* manager) {
  std::vector<std::string> strings = {"colmap"};
  strings.insert(strings.end(), arguments.begin(), arguments.end());
  std::vector<char*> argv;
  for (std::string& string : strings) {
    argv.push_back(string.data());
  }
#if MFIR_COLMAP_MAJOR >= 4
  if (!manager->Parse(static_cast<int>(argv.size()), argv.data())) {
    std::exit(EXIT_FAILURE);
  }
#else
  manager->Parse(static_cast<int>(argv.size()), argv.data());
#endif
  // COLMAP 3.8 makes glog verbose, and with it Ceres.
  const bool log_level_set = std::any_of(
      arguments.begin(), arguments.end(), [](const std::string& argument) {
        return argument.rfind("--log_level", 0) == 0;
      });
  if (!log_level_set) FLAGS_v = 0;
}

const std::vector<std::string>& CommonOptionNames() {
#if MFIR_COLMAP_MAJOR >= 4
  static const std::vector<std::string> names = {"help",
                                                 "project_path",
                                                 "default_random_seed",
                                                 "log_target",
                                                 "log_path",
                                                 "log_level",
                                                 "log_severity",
                                                 "log_color"};
#else
  static const std::vector<std::string> names = {
      "help", "project_path", "random_seed", "log_to_stderr", "log_level"};
#endif
  return names;
}

}  // namespace mfir::host
