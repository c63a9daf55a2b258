// How the result came about: enough to repeat the run.

#include <algorithm>
#include <cmath>
#include <sstream>

#include "src/report/html.h"
#include "src/report/svg.h"
#include "src/report_page/sections.h"

namespace mfir {
namespace {

using Json = nlohmann::ordered_json;

// A value as people write it.
std::string Text(const Json& value) {
  if (value.is_string()) {
    return value.get<std::string>().empty()
               ? "&ndash;"
               : EscapeHtml(value.get<std::string>());
  }
  return EscapeHtml(value.dump());
}

std::string ObjectTable(const Json& object,
                        const std::vector<std::string>& heads) {
  std::vector<std::vector<std::string>> rows;
  for (const auto& item : object.items()) {
    if (item.value().is_structured()) continue;
    rows.push_back(
        {"<code>" + EscapeHtml(item.key()) + "</code>", Text(item.value())});
  }
  return Table(heads, rows);
}

std::string Size(double bytes) {
  if (bytes < 1e3) return Fixed(bytes, 0) + " B";
  if (bytes < 1e6) return Fixed(bytes / 1e3, 1) + " kB";
  if (bytes < 1e9) return Fixed(bytes / 1e6, 1) + " MB";
  return Fixed(bytes / 1e9, 2) + " GB";
}

std::string FilesTable(const Json& inputs) {
  const Json files = inputs.value("files", Json::array());
  if (files.empty()) {
    return "<p>Sizes and hashes of the inputs were not recorded by the "
           "version that made this result.</p>";
  }
  std::vector<std::vector<std::string>> rows;
  for (const Json& file : files) {
    rows.push_back({EscapeHtml(TextAt(file, "/path")),
                    Size(file.value("bytes", 0.0)),
                    "<code class=\"hash\">" +
                        EscapeHtml(TextAt(file, "/sha256")) + "</code>"});
  }
  return Table({"file", "size", "SHA-256"}, rows);
}

std::string NameList(const Json& inputs,
                     const char* field,
                     const std::string& title) {
  if (!inputs.contains(field) || inputs[field].empty()) return "";
  std::string names;
  for (const Json& name : inputs[field]) {
    names += (names.empty() ? "" : ", ") + Text(name);
  }
  return "<p>" + title + ": " + names + ".</p>";
}

std::string Timings(const Json& timings) {
  const double total = timings.value("total", 0.0);
  std::string rows;
  for (const auto& item : timings.items()) {
    if (!item.value().is_number() || item.key() == "total") continue;
    const double seconds = item.value().get<double>();
    const double share = total > 0.0 ? 100.0 * seconds / total : 0.0;
    rows += "<tr><th>" + EscapeHtml(item.key()) + "</th><td>" +
            Fixed(seconds, 1) +
            " s</td><td class=\"meter\"><i class=\"plain\" style=\"width:" +
            Fixed(std::clamp(share, 0.0, 100.0), 0) + "%\"></i></td></tr>";
  }
  return "<table class=\"bars\">" + rows + "</table><p>All together " +
         Fixed(total, 1) + " s.</p>";
}

std::vector<std::string> Split(const std::string& line) {
  std::vector<std::string> cells;
  std::istringstream stream(line);
  std::string cell;
  while (std::getline(stream, cell, ',')) cells.push_back(cell);
  if (!line.empty() && line.back() == ',') cells.push_back("");
  return cells;
}

// Up to six digits of what is a number.
std::string ShortNumber(const std::string& cell) {
  char* end = nullptr;
  const double value = std::strtod(cell.c_str(), &end);
  if (cell.empty() || end == nullptr || *end != '\0') return EscapeHtml(cell);
  std::ostringstream text;
  text.precision(6);
  text << value;
  return text.str();
}

std::string HistoryTable(const std::string& history_csv) {
  std::istringstream lines(history_csv);
  std::string line;
  std::vector<std::string> heads;
  std::vector<std::vector<std::string>> rows;
  while (std::getline(lines, line)) {
    if (line.empty()) continue;
    std::vector<std::string> cells = Split(line);
    if (heads.empty()) {
      for (std::string& cell : cells) {
        std::replace(cell.begin(), cell.end(), '_', ' ');
        heads.push_back(EscapeHtml(cell));
      }
      continue;
    }
    for (std::string& cell : cells) cell = ShortNumber(cell);
    rows.push_back(cells);
  }
  return Table(heads, rows);
}

std::string StagesPlot(const Json& stages) {
  std::vector<Eigen::Vector2d> rms;
  double low = INFINITY;
  double high = 0.0;
  for (size_t i = 0; i < stages.size(); ++i) {
    const Json value = stages[i].value("rms_px", Json(nullptr));
    if (!value.is_number() || value.get<double>() <= 0.0) continue;
    rms.emplace_back(static_cast<double>(i), value.get<double>());
    low = std::min(low, rms.back().y());
    high = std::max(high, rms.back().y());
  }
  if (rms.empty()) return "";
  Plot plot("Rms after each solve",
            {"solve", -0.3, static_cast<double>(stages.size()) - 0.7},
            {"rms (px)", 0.0, 1.1 * high});
  plot.AddLine(rms, "after");
  for (const Eigen::Vector2d& point : rms) {
    const Json& stage = stages[static_cast<size_t>(point.x())];
    plot.AddDot(point, "", TextAt(stage, "/name"), stages.size() <= 6);
  }
  return "<div class=\"figures wide\">" +
         Figure(plot.ToSvg(), "Rms without outliers after each solve") +
         "</div>\n";
}

}  // namespace

std::string ConvergenceSection(const Report& report) {
  return "<section id=\"convergence\"><h2>Convergence</h2>\n<p>Status: <b>" +
         TextField(report.summary, "/result/status") +
         "</b>. The last full step moved no combination of parameters by more "
         "than " +
         Field(report.summary, "/result/last_step_stds", 9) +
         " standard deviations; at most 0.0001 counts as converged.</p>\n" +
         StagesPlot(report.summary.value("stages", Json::array())) +
         Folded("Table of all solves (history.csv)",
                HistoryTable(report.history_csv)) +
         "</section>\n";
}

std::string RunSection(const Report& report) {
  const Json& summary = report.summary;
  const Json inputs = summary.value("inputs", Json::object());
  Json about = summary.value("tool", Json::object());
  about["created"] = TextAt(summary, "/created");
  about["result"] = report.output_path;
  about["peak memory (MB)"] =
      std::round(summary.value("peak_rss_bytes", 0.0) / 1e6);
  return "<section id=\"run\"><h2>This run</h2>\n<p>With the inputs and "
         "options "
         "below the run can be repeated: <code>project.ini</code> beside this "
         "report has the same options, as <code>--project_path</code> takes "
         "them.</p>\n" +
         ObjectTable(about, {"", ""}) +
         NameList(inputs,
                  "cameras_without_images",
                  "Cameras of RIG without images, not in the result") +
         NameList(inputs,
                  "images_without_camera",
                  "Images that belong to no camera of RIG, left out") +
         Folded("Inputs",
                ObjectTable(inputs, {"input", ""}) + FilesTable(inputs)) +
         Folded("Options",
                ObjectTable(summary.value("options", Json::object()),
                            {"option", "value"})) +
         Folded("Timings",
                Timings(summary.value("timings_s", Json::object())),
                true) +
         "</section>\n";
}

}  // namespace mfir
