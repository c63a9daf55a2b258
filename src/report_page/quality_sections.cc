// How well the result explains what was measured.

#include <algorithm>
#include <cmath>
#include <map>

#include "src/report/camera_maps.h"
#include "src/report/html.h"
#include "src/report/svg.h"
#include "src/report_page/sections.h"
#include "src/util/median.h"

namespace mfir {
namespace {

using Json = nlohmann::ordered_json;

std::string Section(const std::string& id,
                    const std::string& title,
                    const std::string& content) {
  return "<section id=\"" + id + "\"><h2>" + title + "</h2>\n" + content +
         "</section>\n";
}

// Density of one component of the noise, both signs together, at x (px).
double MixtureDensity(const Json& mixture, double x) {
  double density = 0.0;
  for (const Json& component : mixture) {
    const double std = component.value("std_px", NAN);
    density += component.value("share", 0.0) * 2.0 /
               (std * std::sqrt(2.0 * M_PI)) *
               std::exp(-0.5 * x * x / (std * std));
  }
  return density;
}

std::string HistogramPlot(const Report& report) {
  const ResidualHistogram& histogram = report.histogram;
  uint64_t total = histogram.num_larger;
  for (const uint64_t count : histogram.counts) total += count;
  const double end =
      histogram.bin_width * static_cast<double>(histogram.counts.size());
  std::vector<double> densities;
  double highest = 1e-6;
  for (const uint64_t count : histogram.counts) {
    densities.push_back(static_cast<double>(count) /
                        (static_cast<double>(total) * histogram.bin_width));
    highest = std::max(highest, densities.back());
  }
  const Json mixture =
      report.summary["result"].value("noise_mixture", Json::array());
  std::vector<Eigen::Vector2d> model;
  for (int i = 0; i <= 120 && !mixture.empty(); ++i) {
    const double x = end * i / 120;
    model.emplace_back(x, MixtureDensity(mixture, x));
    highest = std::max(highest, model.back().y());
  }
  const double low = highest * 1e-4;
  Plot plot("Residuals and noise model",
            {"size of a residual along x or y (px)", 0.0, end},
            {"density (1/px)", low, highest * 1.5, true});
  for (size_t i = 0; i < densities.size(); ++i) {
    const double x = histogram.bin_width * static_cast<double>(i);
    if (densities[i] > low) {
      plot.AddBar(x, x + histogram.bin_width, densities[i], "bar");
    }
  }
  if (!model.empty()) {
    plot.AddLine(model, "after");
    plot.AddLegend("noise model", "after");
  }
  return plot.ToSvg();
}

// Cells of the matrix frames x cameras (frames are rows).
std::string MatrixFigure(const Report& report,
                         const std::vector<double>& values,
                         double high,
                         const std::string& title,
                         const std::string& caption) {
  const size_t columns = report.cameras.size();
  const size_t rows = report.frame_names.size();
  const double cell_width = 420.0 / static_cast<double>(columns);
  const double cell_height =
      std::clamp(360.0 / static_cast<double>(rows), 3.0, 16.0);
  const double height = cell_height * static_cast<double>(rows);
  return Figure(
      Svg(420.0,
          height,
          title,
          "<rect class=\"frame\" x=\"0\" y=\"0\" width=\"420\" height=\"" +
              Coordinate(height) + "\"/>" +
              CellsSvg(values,
                       static_cast<int>(columns),
                       0.0,
                       high,
                       cell_width,
                       cell_height)),
      caption);
}

std::string FrameRows(const Report& report) {
  const Json& frames = report.summary["frames"];
  std::vector<std::vector<std::string>> rows;
  for (size_t i = 0; i < frames.size(); ++i) {
    const std::string pointer = "/frames/" + std::to_string(i) + "/";
    rows.push_back({TextField(report.summary, pointer + "name"),
                    Field(report.summary, pointer + "num_images", 0),
                    Field(report.summary, pointer + "num_points", 0),
                    Field(report.summary, pointer + "num_observations", 0),
                    Field(report.summary, pointer + "alignment_rms", 4),
                    TextField(report.summary, pointer + "status"),
                    EscapeHtml(TextAt(frames[i], "/reason"))});
  }
  return Table({"frame",
                "images",
                "points",
                "observations",
                "alignment (units of RIG)",
                "status",
                "reason"},
               rows);
}

// Parameters whose errors go together, over all cameras: by the names of the
// pair the sizes of their correlation.
std::map<std::string, std::vector<double>> Correlations(const Report& report) {
  std::map<std::string, std::vector<double>> correlations;
  for (const ReportCamera& camera : report.cameras) {
    for (size_t i = 0; i < camera.params.size(); ++i) {
      for (size_t j = 0; j < i; ++j) {
        const auto row = static_cast<Eigen::Index>(i);
        const auto column = static_cast<Eigen::Index>(j);
        const double value = camera.covariance(row, column) /
                             std::sqrt(camera.covariance(row, row) *
                                       camera.covariance(column, column));
        if (!std::isfinite(value)) continue;
        correlations[camera.param_names[j] + " and " + camera.param_names[i]]
            .push_back(std::abs(value));
      }
    }
  }
  return correlations;
}

// Why errors of these two go together.
std::string PairReason(const std::string& pair) {
  if (pair == "fx and fy") {
    return "both follow the common focal scale; their ratio is known better "
           "than either";
  }
  const bool has_focal = !pair.empty() && pair.front() == 'f';
  if (has_focal && (pair.find("cx") != std::string::npos ||
                    pair.find("cy") != std::string::npos)) {
    return "the points lie to one side of the image, where a longer focal "
           "length and a shifted principal point look alike";
  }
  if (has_focal) {
    return "a longer focal length and distortion look alike except at the "
           "border of the image";
  }
  if (pair.find('k') != std::string::npos &&
      pair.find('c') == std::string::npos) {
    return "coefficients of one polynomial make up for one another: look at "
           "the curve, not at the coefficients";
  }
  if (pair.find("p1") != std::string::npos ||
      pair.find("p2") != std::string::npos) {
    return "tangential distortion and a shifted principal point look alike";
  }
  return "";
}

std::string CorrelationRows(const Report& report) {
  std::vector<std::pair<double, std::string>> pairs;
  for (const auto& [name, values] : Correlations(report)) {
    pairs.emplace_back(Median(values), name);
  }
  std::sort(pairs.rbegin(), pairs.rend());
  std::vector<std::vector<std::string>> rows;
  for (size_t i = 0; i < std::min<size_t>(8, pairs.size()); ++i) {
    rows.push_back({EscapeHtml(pairs[i].second),
                    Fixed(pairs[i].first, 2),
                    pairs[i].first > 0.5 ? PairReason(pairs[i].second)
                                         : "hardly related"});
  }
  return Table({"parameters", "correlation (median camera)", "why"}, rows);
}

}  // namespace

std::string ResidualsSection(const Report& report) {
  const Json& summary = report.summary;
  const std::string caption =
      "Bars: residuals of all observations. Line: the noise of a keypoint as "
      "the refinement has estimated it. Residuals are smaller than "
      "the noise, the more so the fewer cameras see a point, since each point "
      "follows its own keypoints.";
  return Section(
      "residuals",
      "Residuals",
      "<p>Keypoints are exact to " + Field(summary, "/result/noise_std_px", 3) +
          " px along each axis (standard deviation); " +
          Field(summary, "/result/outlier_share", 1, 100.0) +
          " % are outliers, which the robust loss sets aside. Residuals "
          "above " +
          Fixed(report.max_inlier_px, 2) +
          " px count as outliers in this report.</p>\n<div class=\"figures "
          "wide\">" +
          Figure(HistogramPlot(report), caption) + "</div>\n");
}

std::string FramesSection(const Report& report) {
  std::vector<double> counts;
  std::vector<double> rms;
  for (const FrameCell& cell : report.matrix) {
    counts.push_back(cell.num_observations > 0 ? cell.num_observations : NAN);
    rms.push_back(cell.num_inliers > 0
                      ? std::sqrt(cell.sum_squared / cell.num_inliers)
                      : NAN);
  }
  const auto high = [](std::vector<double> values, double share) {
    values.erase(std::remove_if(values.begin(),
                                values.end(),
                                [](double value) { return !(value >= 0.0); }),
                 values.end());
    if (values.empty()) return 1.0;
    std::sort(values.begin(), values.end());
    return values[static_cast<size_t>(share *
                                      static_cast<double>(values.size() - 1))];
  };
  const double high_count = high(counts, 0.98);
  // What is usual is in the middle of the scale, so that only what does not fit
  // is bright.
  const double high_rms = 2.0 * high(rms, 0.5);
  const std::string axes =
      ". Rows are frames, from the top; columns are cameras, in the order of "
      "their names; white: nothing there.";
  return Section(
      "frames",
      "Frames and cameras",
      "<p>A dark column is a camera that sees little, a dark row a frame with "
      "few points; in the right picture a bright column is a camera that does "
      "not fit, a bright row a frame in which something moved or was out of "
      "step.</p>\n<div class=\"figures wide\">" +
          MatrixFigure(report,
                       counts,
                       high_count,
                       "Observations by frame and camera",
                       "<b>Observations</b> " +
                           ColorScale("0", Fixed(high_count, 0) + "+") + axes) +
          MatrixFigure(report,
                       rms,
                       high_rms,
                       "Rms by frame and camera",
                       "<b>Rms</b> " +
                           ColorScale("0", Fixed(high_rms, 2) + "+ px") +
                           axes) +
          "</div>\n" +
          Folded("Table of all frames",
                 FrameRows(report),
                 report.summary["frames"].size() <= 20));
}

std::string HeldOutSection(const Report& report) {
  const Json& summary = report.summary;
  const double fitted = NumberAt(summary, "/result/rms_px_after");
  const double held_out = NumberAt(summary, "/result/held_out_rms_px");
  const std::string explanation =
      "<p>A share of the tracks takes no part in the refinement. Their points "
      "are then fitted with the intrinsics held: if these tracks fit as well "
      "as the others, the intrinsics describe the cameras and not the noise of "
      "the tracks that they were fitted to.</p>\n";
  if (!std::isfinite(held_out)) {
    return Section("held-out",
                   "Held out against fitted",
                   explanation +
                       "<p>No tracks were held out "
                       "(<code>--MultiFrame.held_out_share</code>).</p>");
  }
  const double high = 1.15 * std::max(fitted, held_out);
  const auto bar = [&](const char* name,
                       const std::string& pointer,
                       double value,
                       const char* css_class) {
    return std::string("<tr><th>") + name + "</th><td>" +
           Field(summary, pointer, 3) +
           " px</td><td class=\"meter\"><i class=\"" + css_class +
           "\" style=\"width:" + Fixed(100.0 * value / high, 0) +
           "%\"></i></td></tr>";
  };
  return Section("held-out",
                 "Held out against fitted",
                 explanation + "<table class=\"bars\">" +
                     bar("fitted", "/result/rms_px_after", fitted, "good") +
                     bar("held out",
                         "/result/held_out_rms_px",
                         held_out,
                         held_out > 1.3 * fitted ? "look" : "good") +
                     "</table>\n");
}

std::string WeakModesSection(const Report& report) {
  const Json& summary = report.summary;
  const std::string modes = "/result/modes/";
  const auto item = [&](const std::string& name,
                        const std::string& field,
                        int digits,
                        const std::string& unit,
                        const std::string& text) {
    return "<li><b>" + name + "</b>: known to " +
           Field(summary, modes + field, digits) + " " + unit + ". " + text +
           "</li>";
  };
  return Section(
      "weak-modes",
      "Weak modes and correlations",
      "<p>Some combinations of intrinsics are known less well than each camera "
      "alone, because all cameras can change together and the points "
      "follow.</p><ul>" +
          item("One focal scale for all",
               "common_focal_scale_std_permille",
               2,
               "&permil;",
               "If all focal lengths grow and the points move away from the "
               "cameras, the images hardly change. Points at many depths, wide "
               "angles between views and more frames hold it.") +
          item("One shift of all principal points to the side",
               "common_principal_point_shift_x_std_px",
               3,
               "px",
               "In a ring of cameras this looks like points that have turned "
               "about the axis of the ring.") +
          item("One shift of all principal points up or down",
               "common_principal_point_shift_y_std_px",
               3,
               "px",
               "This looks like points that have moved up or down.") +
          "</ul>\n<h3>Within a camera</h3>" + CorrelationRows(report));
}

std::string StaticSection(const Report& report) {
  const Json& summary = report.summary;
  const std::string choice =
      summary["options"].value("MultiFrame.static_points", "keep");
  const std::string meaning =
      choice == "drop"    ? "They were left out."
      : choice == "merge" ? "Each counts once."
                          : "They were kept, and all tracks of a static point "
                            "count as one piece of evidence for the standard "
                            "deviations.";
  return Section(
      "static",
      "Static background",
      "<p>" + Field(summary, "/result/static_points/num_points", 0) +
          " points do not move between frames; their " +
          Field(summary, "/result/static_points/num_tracks", 0) +
          " tracks have " +
          Field(summary, "/result/static_points/observation_share", 1, 100.0) +
          " % of the observations. They repeat the same measurement, so more "
          "frames do not average their errors out. " +
          meaning + "</p>");
}

std::string EvaluationSection(const Report& report) {
  if (!report.summary.contains("evaluation")) return "";
  const auto row = [&](const std::string& name,
                       const std::string& field,
                       const std::string& unit) {
    return std::vector<std::string>{
        name, Field(report.summary, "/evaluation/" + field + "/mean", 3), unit};
  };
  return Section(
      "evaluation",
      "Against the ground truth",
      "<p>Mean errors over all cameras, sums of both axes. The truth had no "
      "influence on the result.</p>" +
          Table({"", "mean error", ""},
                {row("focal lengths", "focal_abs", "px"),
                 row("focal lengths, relative", "focal_rel", "&permil;"),
                 row("principal points", "pp_abs", "px"),
                 row("principal points, relative", "pp_rel", "&permil;")}));
}

}  // namespace mfir
