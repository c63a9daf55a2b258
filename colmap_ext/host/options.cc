#include "colmap_ext/host/options.h"

#include <algorithm>
#include <cstdlib>

#if MFIR_COLMAP_MAJOR >= 4
#include <iostream>

#include <boost/program_options.hpp>

#include "colmap/util/version.h"
#endif

namespace mfir::host {
#if MFIR_COLMAP_MAJOR >= 4
namespace {

namespace po = boost::program_options;

// COLMAP's description of the options is for derived classes.
struct Described : OptionManager {
  static const po::options_description& Options(const OptionManager& manager) {
    return *(manager.*(&Described::desc_));
  }
};

// COLMAP 4 reports help and errors through its log.
void ReportAsColmap3(int argc, char** argv, const OptionManager& manager) {
  const po::options_description& options = Described::Options(manager);
  try {
    po::variables_map map;
    po::store(po::parse_command_line(argc, argv, options), map);
    if (map.count("help") == 0) return;
  } catch (const po::error& error) {
    std::cerr << "ERROR: Failed to parse options - " << error.what() << "."
              << std::endl;
    std::exit(EXIT_FAILURE);
  }
  std::cout << colmap::GetVersionInfo() << " (" << colmap::GetBuildInfo()
            << ")\n\n"
               "Options can either be specified via command-line or by "
               "defining\n"
               "them in a .ini project file passed to `--project_path`.\n\n"
            << options << std::endl;
  std::exit(EXIT_SUCCESS);
}

}  // namespace
#endif

void ParseOptions(const std::vector<std::string>& arguments,
                  OptionManager* manager) {
  std::vector<std::string> strings = {"colmap"};
  strings.insert(strings.end(), arguments.begin(), arguments.end());
  std::vector<char*> argv;
  for (std::string& string : strings) {
    argv.push_back(string.data());
  }
#if MFIR_COLMAP_MAJOR >= 4
  ReportAsColmap3(static_cast<int>(argv.size()), argv.data(), *manager);
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
