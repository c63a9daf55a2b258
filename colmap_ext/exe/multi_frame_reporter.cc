// The command multi_frame_reporter.

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <string>
#include <vector>

#include "colmap_ext/exe/command.h"
#include "colmap_ext/io/work_folder.h"
#include "colmap_ext/options/option_parser.h"
#include "colmap_ext/report/report_reader.h"
#include "src/report_page/report_page.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

struct ReporterOptions {
  std::string input_path;
  std::vector<std::string> compare_paths;
  std::string output_path;
};

// Takes all --compare_path out of the arguments: the parser has options that
// occur once.
std::vector<std::string> TakeComparePaths(std::vector<char*>* arguments) {
  const std::string name = "--compare_path";
  std::vector<std::string> paths;
  std::vector<char*> others;
  for (size_t i = 0; i < arguments->size(); ++i) {
    const std::string argument = (*arguments)[i];
    if (argument == name && i + 1 < arguments->size()) {
      paths.push_back((*arguments)[++i]);
    } else if (argument.rfind(name + "=", 0) == 0) {
      paths.push_back(argument.substr(name.size() + 1));
    } else {
      others.push_back((*arguments)[i]);
    }
  }
  *arguments = others;
  return paths;
}

ReporterOptions ParseReporterOptions(int argc, char** argv) {
  ReporterOptions options;
  std::vector<char*> arguments(argv, argv + argc);
  options.compare_paths = TakeComparePaths(&arguments);
  std::string compare_path;  // of an ini file
  OptionParser parser;
  parser.SetHelp(
      "Writes the report of a result as one HTML file: what can be trusted, "
      "what has changed, and which\ncamera needs a hand.",
      "colmap multi_frame_reporter --input_path OUT --compare_path "
      "OUT_YESTERDAY");
  parser.AddRequired("input_path",
                     &options.input_path,
                     "Result of multi_frame_intrinsics_refiner");
  parser.Add("compare_path",
             &compare_path,
             "Earlier result of the same cameras; may be given several times");
  parser.Add("output_path",
             &options.output_path,
             "HTML file to write; empty: report.html in input_path");
  parser.Parse(static_cast<int>(arguments.size()), arguments.data());
  if (options.compare_paths.empty() && !compare_path.empty()) {
    options.compare_paths.push_back(compare_path);
  }
  if (options.output_path.empty()) {
    options.output_path =
        (fs::path(options.input_path) / "report.html").string();
  }
  return options;
}

// What is there already must be a report: it could be anything.
void CheckReporterOutput(const std::string& path) {
  std::error_code ignored;
  if (!fs::exists(path, ignored)) return;
  if (!fs::is_regular_file(path, ignored)) {
    throw OutputError("--output_path " + path + " is not a regular file.");
  }
  std::ifstream file(path);
  std::string begin(1000, '\0');
  file.read(begin.data(), static_cast<std::streamsize>(begin.size()));
  if (begin.find(kReportGenerator) == std::string::npos) {
    throw OutputError("--output_path " + path +
                      " exists, and is no report: it is not replaced. Remove "
                      "it, or give another file.");
  }
}

}  // namespace

int RunMultiFrameReporter(int argc, char** argv) {
  return RunCommand([argc, argv]() {
    const ReporterOptions options = ParseReporterOptions(argc, argv);
    CheckReporterOutput(options.output_path);
    const Report report = ReadReport(
        options.input_path, options.input_path, options.compare_paths);
    ReplaceFile(options.output_path, MakeReportPage(report));
    std::cout << "Written to " << options.output_path << std::endl;
  });
}

}  // namespace mfir
