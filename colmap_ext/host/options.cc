#include "colmap_ext/host/options.h"

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <iostream>

#include "colmap_ext/host/util.h"
#include "src/util/errors.h"

#if MFIR_COLMAP_MAJOR >= 4
#include <boost/program_options.hpp>

#include "colmap/util/version.h"
#endif

namespace mfir::host {
namespace {

void CheckLogTarget(const std::string& target) {
  for (const char* known : {"stderr", "stdout", "file", "stderr_and_file"}) {
    if (target == known) return;
  }
  throw UsageError(
      "--log_target must be stderr, stdout, file or stderr_and_file, but is " +
      target + ".");
}

#if MFIR_COLMAP_MAJOR >= 4
namespace po = boost::program_options;

// COLMAP 4 makes one level of folders, and throws where a file is in the way.
void MakeLogFolder(const std::string& path) {
  if (path.empty()) return;
  std::error_code error;
  std::filesystem::create_directories(path, error);
  if (!std::filesystem::is_directory(path)) {
    throw OutputError("--log_path " + path + ": cannot make the folder: " +
                      (error ? error.message() : "a file is in the way") + ".");
  }
}

// COLMAP's description of the options is for derived classes.
struct Described : OptionManager {
  static const po::options_description& Options(const OptionManager& manager) {
    return *(manager.*(&Described::desc_));
  }
};

// COLMAP 4 reports help and errors through its log.
LogOptions ReportAsColmap3(int argc,
                           char** argv,
                           const OptionManager& manager) {
  const po::options_description& options = Described::Options(manager);
  try {
    po::variables_map map;
    po::store(po::parse_command_line(argc, argv, options), map);
    if (map.count("help") == 0) {
      return {map["log_target"].as<std::string>(),
              map["log_path"].as<std::string>()};
    }
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
#endif

}  // namespace

LogOptions ParseOptions(const std::vector<std::string>& arguments,
                        OptionManager* manager) {
  std::vector<std::string> strings = {"colmap"};
  strings.insert(strings.end(), arguments.begin(), arguments.end());
  std::vector<char*> argv;
  for (std::string& string : strings) {
    argv.push_back(string.data());
  }
#if MFIR_COLMAP_MAJOR >= 4
  const LogOptions log =
      ReportAsColmap3(static_cast<int>(argv.size()), argv.data(), *manager);
  // COLMAP 4 would take another for stderr_and_file.
  CheckLogTarget(log.target);
  if (log.ToFile()) MakeLogFolder(log.path);
  if (!manager->Parse(static_cast<int>(argv.size()), argv.data())) {
    std::exit(EXIT_FAILURE);
  }
#else
  LogOptions log;
  manager->AddDefaultOption("log_target", &log.target);
  manager->AddDefaultOption("log_path", &log.path);
  manager->Parse(static_cast<int>(argv.size()), argv.data());
  CheckLogTarget(log.target);
  FLAGS_logtostderr |= !log.ToFile();
  if (!log.path.empty()) FLAGS_log_dir = log.path;
#endif
  // COLMAP 3.8 makes glog verbose, and with it Ceres.
  const bool log_level_set = std::any_of(
      arguments.begin(), arguments.end(), [](const std::string& argument) {
        return argument.rfind("--log_level", 0) == 0;
      });
  if (!log_level_set) FLAGS_v = 0;
  return log;
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
  static const std::vector<std::string> names = {"help",
                                                 "project_path",
                                                 "random_seed",
                                                 "log_target",
                                                 "log_path",
                                                 "log_to_stderr",
                                                 "log_level"};
#endif
  return names;
}

std::string PlaceOfOption(const std::string& name) {
  struct Place {
    const char* name;
    const char* place;
  };
#if MFIR_COLMAP_MAJOR >= 4
  const char* const kOther = "3.8";
  static constexpr Place kPlaces[] = {
      {"log_to_stderr", "--log_target stderr"},
      {"random_seed", "--default_random_seed"},
      {"SiftExtraction.num_threads", "--FeatureExtraction.num_threads"},
      {"SiftExtraction.use_gpu", "--FeatureExtraction.use_gpu"},
      {"SiftExtraction.gpu_index", "--FeatureExtraction.gpu_index"},
      {"SiftExtraction.max_image_size", "--FeatureExtraction.max_image_size"},
      {"SiftMatching.num_threads", "--FeatureMatching.num_threads"},
      {"SiftMatching.use_gpu", "--FeatureMatching.use_gpu"},
      {"SiftMatching.gpu_index", "--FeatureMatching.gpu_index"},
      {"SiftMatching.max_num_matches", "--FeatureMatching.max_num_matches"},
      {"SiftMatching.guided_matching", "--FeatureMatching.guided_matching"},
      {"SiftMatching.min_num_inliers", "--TwoViewGeometry.min_num_inliers"}};
#else
  const char* const kOther = "4";
  static constexpr Place kPlaces[] = {
      {"log_severity", "--log_level"},
      {"log_color", "--log_to_stderr"},
      {"default_random_seed", "--random_seed"},
      {"FeatureExtraction.type", "SIFT only"},
      {"FeatureExtraction.num_threads", "--SiftExtraction.num_threads"},
      {"FeatureExtraction.use_gpu", "--SiftExtraction.use_gpu"},
      {"FeatureExtraction.gpu_index", "--SiftExtraction.gpu_index"},
      {"FeatureExtraction.max_image_size", "--SiftExtraction.max_image_size"},
      {"FeatureMatching.type", "nearest neighbours of SIFT only"},
      {"FeatureMatching.num_threads", "--SiftMatching.num_threads"},
      {"FeatureMatching.use_gpu", "--SiftMatching.use_gpu"},
      {"FeatureMatching.gpu_index", "--SiftMatching.gpu_index"},
      {"FeatureMatching.max_num_matches", "--SiftMatching.max_num_matches"},
      {"FeatureMatching.guided_matching", "--SiftMatching.guided_matching"},
      {"TwoViewGeometry.min_num_inliers", "--SiftMatching.min_num_inliers"}};
#endif
  for (const Place& place : kPlaces) {
    if (name == place.name) {
      return "--" + name + " is an option of COLMAP " + kOther +
             "; this program is built with " + VersionInfo() + ", which has " +
             place.place + ".";
    }
  }
  return "";
}

}  // namespace mfir::host
