#include "src/report_page/report_page.h"

#include <utility>
#include <vector>

#include "src/report/html.h"
#include "src/report_page/sections.h"
#include "src/util/errors.h"

namespace mfir {

const char kReportGenerator[] = "multi_frame_reporter";

namespace {

// Made by CMake from page.css and page.js.
const char kStyle[] =
#include <report_style.inc>
    ;
const char kScript[] =
#include <report_script.inc>
    ;

std::string Navigation(
    const std::vector<std::pair<std::string, std::string>>& sections) {
  std::string links;
  for (const auto& [id, title] : sections) {
    links += "<a href=\"#" + id + "\">" + title + "</a>\n";
  }
  return "<nav class=\"screen\">" + links + "</nav>\n";
}

std::string MakePage(const Report& report) {
  const std::string history = HistorySection(report);
  const std::string evaluation = EvaluationSection(report);
  std::vector<std::pair<std::string, std::string>> sections = {
      {"verdict", "Verdict"}, {"changes", "Changes"}};
  if (!history.empty()) sections.emplace_back("history", "History");
  for (const auto& section : std::vector<std::pair<std::string, std::string>>{
           {"array", "Array"},
           {"cameras", "Cameras"},
           {"residuals", "Residuals"},
           {"frames", "Frames"},
           {"held-out", "Held out"},
           {"weak-modes", "Weak modes"},
           {"convergence", "Convergence"},
           {"examples", "Examples"},
           {"static", "Static"}}) {
    sections.push_back(section);
  }
  if (!evaluation.empty()) sections.emplace_back("evaluation", "Truth");
  sections.emplace_back("run", "This run");

  const auto& summary = report.summary;
  const std::string created = TextAt(summary, "/created");
  const std::string title = "Calibration of " +
                            Plural(report.cameras.size(), "camera") + " from " +
                            Plural(report.frame_names.size(), "frame");
  return "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\n"
         "<meta name=\"viewport\" content=\"width=device-width, "
         "initial-scale=1\">\n<meta name=\"generator\" content=\"" +
         std::string(kReportGenerator) + "\">\n<title>" + title +
         "</title>\n<link rel=\"icon\" href=\"data:,\">\n<style>" + kStyle +
         "</style></head>\n<body><header><h1>" + title + "</h1><p>" +
         EscapeHtml(report.output_path) +
         (created.empty() ? "" : " &middot; " + EscapeHtml(created)) +
         "</p></header>\n" + Navigation(sections) + "<main>\n" +
         VerdictSection(report) + ChangesSection(report) + history +
         ArraySection(report) + CamerasSection(report) +
         ResidualsSection(report) + FramesSection(report) +
         HeldOutSection(report) + WeakModesSection(report) +
         ConvergenceSection(report) + ExamplesSection(report) +
         StaticSection(report) + evaluation + RunSection(report) +
         "</main>\n<script>" + kScript + "</script></body></html>\n";
}

}  // namespace

std::string MakeReportPage(const Report& report) {
  try {
    return MakePage(report);
  } catch (const nlohmann::json::exception& error) {
    throw InputError(std::string("summary.json: ") + error.what() +
                     ". Give a folder as multi_frame_intrinsics_refiner has "
                     "written it.");
  }
}

}  // namespace mfir
