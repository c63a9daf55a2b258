// The command multi_frame_automatic_refiner: from images and RIG to the refined
// rig, the commands of the single steps in turn.

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <set>

#include <nlohmann/json.hpp>

#include "colmap_ext/exe/command.h"
#include "colmap_ext/exe/refiner_options.h"
#include "colmap_ext/host/log.h"
#include "colmap_ext/host/options.h"
#include "colmap_ext/host/util.h"
#include "colmap_ext/options/log_file.h"
#include "colmap_ext/options/option_parser.h"
#include "colmap_ext/options/triangulator_options.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

struct Argument {
  std::string name;  // without dashes
  std::string value;
};

std::set<std::string> Names(const OptionParser& parser) {
  const std::vector<std::string>& common = host::CommonOptionNames();
  std::set<std::string> names(common.begin(), common.end());
  const nlohmann::ordered_json options = parser.ToJson();
  for (const auto& option : options.items()) names.insert(option.key());
  return names;
}

std::set<std::string> TriangulatorNames() {
  TriangulatorOptions options;
  OptionParser parser;
  AddTriangulatorOptions(&options, &parser);
  return Names(parser);
}

std::set<std::string> RefinerNames() {
  RefinerOptions options;
  OptionParser parser;
  AddRefinerOptions(&options, &parser);
  return Names(parser);
}

void PrintHelp() {
  std::cout
      << "From images and known extrinsics to refined intrinsics: W/frames "
         "(multi_frame_triangulator) and W/refined\n"
         "(multi_frame_intrinsics_refiner). Run again, it goes on where it "
         "ended.\n\n"
         "Example:\n  colmap multi_frame_automatic_refiner --workspace_path W "
         "--image_path IMAGES --extrinsics_path RIG\n\n"
         "Options: --workspace_path, and all of the two commands but "
         "input_path "
         "and output_path; see their --help.\n";
}

// "--name value" and "--name=value".
std::vector<Argument> ReadArguments(int argc, char** argv) {
  std::vector<Argument> arguments;
  for (int i = 1; i < argc; ++i) {
    const std::string text = argv[i];
    const size_t equals = text.find('=');
    if (text.size() < 3 || text.compare(0, 2, "--") != 0) {
      throw UsageError("'" + text +
                       "' is not an option. Options are given as --name "
                       "value.");
    }
    if (equals != std::string::npos) {
      arguments.push_back(
          {text.substr(2, equals - 2), text.substr(equals + 1)});
    } else if (i + 1 < argc) {
      arguments.push_back({text.substr(2), argv[++i]});
    } else {
      throw UsageError(text + " has no value.");
    }
  }
  return arguments;
}

// What the user gave for a required option. Removes it from the arguments.
std::string Take(const std::string& name, std::vector<Argument>* arguments) {
  for (auto it = arguments->begin(); it != arguments->end(); ++it) {
    if (it->name != name) continue;
    std::string value = it->value;
    arguments->erase(it);
    return value;
  }
  throw UsageError("--" + name + " is missing.");
}

using Command = int (*)(int, char**);

int RunStep(const std::string& heading,
            const std::string& name,
            Command command,
            const std::set<std::string>& names,
            const std::vector<Argument>& arguments) {
  host::PrintHeading1(heading);
  std::vector<std::string> texts = {name};
  for (const Argument& argument : arguments) {
    if (names.count(argument.name) == 0) continue;
    texts.push_back("--" + argument.name);
    texts.push_back(argument.value);
  }
  std::vector<char*> argv;
  for (std::string& text : texts) argv.push_back(text.data());
  return command(static_cast<int>(argv.size()), argv.data());
}

double ParamOrNaN(const Json& camera, const char* key, size_t idx) {
  const Json& values = camera[key];
  return idx < values.size() && values[idx].is_number()
             ? values[idx].get<double>()
             : std::nan("");
}

std::string JoinedFlags(const Json& camera) {
  std::string flags;
  for (const Json& flag : camera["flags"]) {
    flags += (flags.empty() ? "" : ", ") + flag.get<std::string>();
  }
  return flags;
}

// All models of COLMAP begin with f or fx, fy, and have cx, cy next.
void PrintCamera(const Json& camera) {
  const std::string model = camera["model"];
  const bool one_focal =
      model.compare(0, 6, "SIMPLE") == 0 || model.compare(0, 6, "RADIAL") == 0;
  const size_t cx = one_focal ? 1 : 2;
  const auto change = [&](size_t idx) {
    return ParamOrNaN(camera, "params", idx) -
           ParamOrNaN(camera, "params_initial", idx);
  };
  const double focal_length = ParamOrNaN(camera, "params", 0);
  const double to_permille = 1000.0 / focal_length;
  const double rms = camera["rms_px_after"].is_number()
                         ? camera["rms_px_after"].get<double>()
                         : std::nan("");
  std::cout << host::StringPrintf(
                   "%-16s %10.2f %+8.3f %7.3f %+8.3f %+8.3f %7.3f %7.3f  %s",
                   camera["name"].get<std::string>().c_str(),
                   focal_length,
                   to_permille * change(0),
                   to_permille * ParamOrNaN(camera, "params_std", 0),
                   change(cx),
                   change(cx + 1),
                   std::max(ParamOrNaN(camera, "params_std", cx),
                            ParamOrNaN(camera, "params_std", cx + 1)),
                   rms,
                   JoinedFlags(camera).c_str())
            << "\n";
}

// What changed, and whether to trust it.
void PrintSummary(const fs::path& path) {
  std::ifstream file(path);
  const Json summary = Json::parse(file, nullptr, /*allow_exceptions=*/false);
  if (!summary.is_object()) {
    throw OutputError(path.string() + ": cannot be read again.");
  }
  host::PrintHeading1("What has changed");
  std::cout << host::StringPrintf("%-16s %10s %8s %7s %8s %8s %7s %7s  %s\n",
                                  "camera",
                                  "f (px)",
                                  "df (0/00)",
                                  "std",
                                  "dcx (px)",
                                  "dcy (px)",
                                  "std",
                                  "rms",
                                  "flags");
  size_t num_flagged = 0;
  for (const Json& camera : summary["cameras"]) {
    PrintCamera(camera);
    num_flagged += camera["flags"].empty() ? 0 : 1;
  }
  const Json& result = summary["result"];
  const auto number = [](const Json& value) {
    return value.is_number() ? value.get<double>() : std::nan("");
  };
  std::cout << host::StringPrintf(
      "\nChanges are against the start. Status: %s. rms %.3f px, %.3f px on "
      "tracks that were held out.\n",
      result["status"].get<std::string>().c_str(),
      number(result["rms_px_after"]),
      number(result["held_out_rms_px"]));
  if (num_flagged == 0) {
    std::cout << "No camera is flagged: the result can be trusted as far as "
                 "its standard deviations tell.\n";
  } else {
    std::cout << num_flagged << " of " << summary["cameras"].size()
              << " cameras are flagged: look at these before the result is "
                 "used. The others can be trusted as far as their standard "
                 "deviations tell.\n";
  }
  std::cout << std::flush;
}

void CheckNames(const std::vector<Argument>& arguments,
                const std::set<std::string>& names1,
                const std::set<std::string>& names2) {
  for (const Argument& argument : arguments) {
    const std::string& name = argument.name;
    if (name == "input_path" || name == "output_path") {
      throw UsageError("--" + name +
                       " is not for this command: it works in "
                       "--workspace_path.");
    }
    if (names1.count(name) + names2.count(name) == 0) {
      const std::string place = host::PlaceOfOption(name);
      if (!place.empty()) throw UsageError(place);
      throw UsageError("--" + name +
                       " is an option of neither multi_frame_triangulator nor "
                       "multi_frame_intrinsics_refiner.");
    }
  }
}

// The steps would begin one of their own, after the first heading.
void BeginLogFileOf(int argc, char** argv, const std::vector<Argument>& given) {
  host::LogOptions options;
  for (const Argument& argument : given) {
    if (argument.name == "log_path") options.path = argument.value;
    if (argument.name == "log_target") options.target = argument.value;
  }
  BeginLogFile(
      options, "multi_frame_automatic_refiner", {argv + 1, argv + argc});
}

int Run(int argc, char** argv) {
  for (int i = 1; i < argc; ++i) {
    const std::string text = argv[i];
    if (text == "--help" || text == "-h") {
      PrintHelp();
      return kExitSuccess;
    }
  }
  std::vector<Argument> arguments = ReadArguments(argc, argv);
  const fs::path workspace = Take("workspace_path", &arguments);
  const std::set<std::string> triangulator = TriangulatorNames();
  const std::set<std::string> refiner = RefinerNames();
  CheckNames(arguments, triangulator, refiner);
  BeginLogFileOf(argc, argv, arguments);
  const std::string frames = (workspace / "frames").string();
  const std::string refined = (workspace / "refined").string();
  // Two lists: frames are the output of one and the input of the other.
  std::vector<Argument> first = arguments;
  first.push_back({"output_path", frames});
  int exit_code = RunStep("1 of 2: frames from images",
                          "multi_frame_triangulator",
                          RunMultiFrameTriangulator,
                          triangulator,
                          first);
  if (exit_code != kExitSuccess) return exit_code;
  std::vector<Argument> second = arguments;
  const fs::path frame_list = fs::path(frames) / kFrameListName;
  if (fs::exists(frame_list)) {
    second.erase(std::remove_if(second.begin(),
                                second.end(),
                                [](const Argument& argument) {
                                  return argument.name == "frame_list_path";
                                }),
                 second.end());
    second.push_back({"frame_list_path", frame_list.string()});
  }
  second.push_back({"input_path", frames});
  second.push_back({"output_path", refined});
  exit_code = RunStep("2 of 2: refinement",
                      "multi_frame_intrinsics_refiner",
                      RunMultiFrameIntrinsicsRefiner,
                      refiner,
                      second);
  if (exit_code == kExitSuccess || exit_code == kExitOutsideLimits) {
    PrintSummary(fs::path(refined) / "summary.json");
  }
  return exit_code;
}

}  // namespace

int RunMultiFrameAutomaticRefiner(int argc, char** argv) {
  int exit_code = kExitSuccess;
  const int error = RunCommand([&]() { exit_code = Run(argc, argv); });
  return error != kExitSuccess ? error : exit_code;
}

}  // namespace mfir
