#include <algorithm>
#include <cmath>
#include <numeric>

#include "src/report/camera_figures.h"
#include "src/report/camera_maps.h"
#include "src/report/html.h"
#include "src/report/svg.h"
#include "src/report_page/sections.h"
#include "src/util/median.h"

namespace mfir {
namespace {

// Change of a camera since a reference.
struct Change {
  size_t camera_idx = 0;
  PinholeValues before;
  PinholeValues after;
  PinholeStds stds;  // of the difference
  double focal_permille = 0.0;
  double focal_permille_std = 0.0;
  double max_displacement = 0.0;  // px, in the image
  bool is_unusual = false;
  double robust_stds = NAN;  // against the other cameras

  double FocalDifference() const {
    return after.focal_length - before.focal_length;
  }
  Eigen::Vector2d Shift() const {
    return after.principal_point - before.principal_point;
  }
};

double SumOfSquares(double a, double b) { return std::sqrt(a * a + b * b); }

Change MakeChange(const Report& report,
                  const Comparison& reference,
                  size_t camera_idx) {
  const ReportCamera& camera = report.cameras[camera_idx];
  const CameraValues& earlier = reference.cameras[camera_idx];
  Change change;
  change.camera_idx = camera_idx;
  change.before = ToPinhole(earlier);
  change.after = ToPinhole(Values(camera));
  change.stds = ToPinholeStds(Values(camera));
  if (reference.is_result) {
    const PinholeStds stds = ToPinholeStds(earlier);
    change.stds = {
        SumOfSquares(change.stds.focal_length, stds.focal_length),
        SumOfSquares(change.stds.principal_point, stds.principal_point)};
  }
  const double permille = 1000.0 / change.before.focal_length;
  change.focal_permille = permille * change.FocalDifference();
  change.focal_permille_std = permille * change.stds.focal_length;
  for (const Eigen::Vector2d& displacement :
       Displacements(earlier,
                     Values(camera),
                     GridPoints(camera.width, camera.height, 12, 8))) {
    if (displacement.allFinite()) {
      change.max_displacement =
          std::max(change.max_displacement, displacement.norm());
    }
  }
  const std::optional<CameraDrift>& drift = reference.drifts[camera_idx];
  if (drift) {
    change.is_unusual = drift->is_unusual;
    change.robust_stds =
        std::max(drift->focal_stds, drift->principal_point_stds);
  }
  return change;
}

// The unusual ones first, then by what the change does in the image.
std::vector<Change> MakeChanges(const Report& report,
                                const Comparison& reference) {
  std::vector<Change> changes;
  for (size_t i = 0; i < report.cameras.size(); ++i) {
    if (Knows(reference, i)) {
      changes.push_back(MakeChange(report, reference, i));
    }
  }
  std::stable_sort(
      changes.begin(), changes.end(), [](const Change& a, const Change& b) {
        if (a.is_unusual != b.is_unusual) return a.is_unusual;
        return a.max_displacement > b.max_displacement;
      });
  return changes;
}

std::string FocalPlot(const Report& report,
                      const std::vector<Change>& changes) {
  double low = 0.0;
  double high = 0.0;
  for (const Change& change : changes) {
    const double error = std::isfinite(change.focal_permille_std)
                             ? 2.0 * change.focal_permille_std
                             : 0.0;
    low = std::min(low, change.focal_permille - error);
    high = std::max(high, change.focal_permille + error);
  }
  const double margin = std::max(0.1, 0.08 * (high - low));
  std::vector<Change> by_camera = changes;
  std::sort(
      by_camera.begin(), by_camera.end(), [](const Change& a, const Change& b) {
        return a.camera_idx < b.camera_idx;
      });
  Plot plot("Change of the focal lengths",
            {"cameras, in the order of their names",
             -0.5,
             static_cast<double>(report.cameras.size()) - 0.5},
            {"focal length (&permil;)", low - margin, high + margin});
  plot.HideXTicks();
  for (const Change& change : by_camera) {
    const Eigen::Vector2d point(static_cast<double>(change.camera_idx),
                                change.focal_permille);
    plot.AddErrorBar(point, 2.0 * change.focal_permille_std);
    plot.AddDot(point,
                change.is_unusual ? "unusual" : "",
                report.cameras[change.camera_idx].name,
                change.is_unusual);
  }
  return Figure(plot.ToSvg(),
                "Focal lengths, with two standard deviations; a camera that "
                "stands out is named");
}

std::string PrincipalPointPlot(const Report& report,
                               const std::vector<Change>& changes) {
  double largest = 0.1;
  for (const Change& change : changes) {
    largest = std::max(largest, change.Shift().cwiseAbs().maxCoeff());
  }
  largest *= 1.1;
  // Both axes have the same scale.
  const double aspect = (420.0 - 64.0) / (240.0 - 54.0);
  Plot plot("Change of the principal points",
            {"to the right (px)", -largest * aspect, largest * aspect},
            {"up (px)", -largest, largest});
  for (const Change& change : changes) {
    plot.AddDot({change.Shift().x(), -change.Shift().y()},
                change.is_unusual ? "unusual" : "",
                report.cameras[change.camera_idx].name,
                change.is_unusual);
  }
  return Figure(plot.ToSvg(), "Principal points");
}

std::string Significance(double change, double std) {
  return std > 0.0 ? Fixed(std::abs(change) / std, 1) : Fixed(NAN, 1);
}

std::string ChangesTable(const Report& report,
                         const std::vector<Change>& changes) {
  std::vector<std::vector<std::string>> rows;
  for (const Change& change : changes) {
    const Eigen::Vector2d shift = change.Shift();
    rows.push_back(
        {"<a href=\"#camera-" + std::to_string(change.camera_idx) + "\">" +
             EscapeHtml(report.cameras[change.camera_idx].name) + "</a>" +
             (change.is_unusual ? " <span class=\"badge look\">unusual</span>"
                                : ""),
         Fixed(change.after.focal_length, 2),
         Signed(change.FocalDifference(), 2),
         Signed(change.focal_permille, 2),
         Fixed(change.stds.focal_length, 2),
         Significance(change.FocalDifference(), change.stds.focal_length),
         Signed(shift.x(), 2),
         Signed(shift.y(), 2),
         Fixed(change.stds.principal_point, 2),
         Significance(shift.norm() / std::sqrt(2.0),
                      change.stds.principal_point),
         Fixed(change.max_displacement, 2)});
  }
  return Table({"camera",
                "focal length (px)",
                "change (px)",
                "(&permil;)",
                "&plusmn; (px)",
                "change / &plusmn;",
                "principal point x (px)",
                "y (px)",
                "&plusmn; (px)",
                "change / &plusmn;",
                "largest in the image (px)"},
               rows);
}

std::string ChangesSummary(const std::vector<Change>& changes) {
  std::vector<double> focal;
  std::vector<double> x;
  std::vector<double> y;
  size_t num_unusual = 0;
  for (const Change& change : changes) {
    focal.push_back(change.focal_permille);
    x.push_back(change.Shift().x());
    y.push_back(change.Shift().y());
    num_unusual += change.is_unusual;
  }
  return "<p>The median camera has changed by " + Signed(Median(focal), 2) +
         " &permil; in focal length and (" + Signed(Median(x), 2) + ", " +
         Signed(Median(y), 2) + ") px in principal point. " +
         (num_unusual == 0
              ? std::string("None has changed unusually against the others.")
              : Plural(num_unusual, "camera") +
                    (num_unusual == 1 ? " has" : " have") +
                    " changed far more than the others.") +
         "</p>\n";
}

std::string Since(const Report& report, const Comparison& reference) {
  const std::vector<Change> changes = MakeChanges(report, reference);
  if (changes.empty()) {
    return "<p>No camera of this result is in " + EscapeHtml(reference.label) +
           ".</p>\n";
  }
  const std::string missing =
      changes.size() == report.cameras.size()
          ? ""
          : "<p>" + Plural(report.cameras.size() - changes.size(), "camera") +
                " cannot be compared: not there, or without intrinsics.</p>\n";
  return ChangesSummary(changes) + missing + "<div class=\"figures wide\">" +
         FocalPlot(report, changes) + PrincipalPointPlot(report, changes) +
         "</div>\n" +
         Folded("Table of all cameras",
                ChangesTable(report, changes),
                changes.size() <= 40);
}

// What the change does in the images of the cameras that it moves most.
std::string LargestDisplacements(const Report& report) {
  const std::vector<Change> changes =
      MakeChanges(report, MainReference(report));
  const FigureScales scales = MakeFigureScales(report);
  std::string figures;
  for (size_t i = 0; i < std::min<size_t>(6, changes.size()); ++i) {
    const ReportCamera& camera = report.cameras[changes[i].camera_idx];
    figures += Figure(DisplacementSvg(report, scales, changes[i].camera_idx),
                      "<b>" + EscapeHtml(camera.name) + "</b>, largest " +
                          Fixed(changes[i].max_displacement, 2) + " px");
  }
  if (figures.empty()) return "";
  return "<h3>What the change does in the image</h3><p>Where the same ray is "
         "seen now, against where it was seen under " +
         EscapeHtml(MainReference(report).label) + ". Arrows are " +
         Fixed(scales.displacement_factor,
               scales.displacement_factor < 1.0 ? 2 : 0) +
         " times as long as the change. The cameras with the largest changes; "
         "all others are <a href=\"#cameras\">below</a>.</p>"
         "<div class=\"figures\">" +
         figures + "</div>\n";
}

bool HasSameValues(const Comparison& a, const Comparison& b) {
  if (a.cameras.size() != b.cameras.size()) return false;
  for (size_t i = 0; i < a.cameras.size(); ++i) {
    if (a.cameras[i].model != b.cameras[i].model ||
        a.cameras[i].params != b.cameras[i].params) {
      return false;
    }
  }
  return true;
}

// Values of a camera over the results, the present one last.
std::vector<Eigen::Vector2d> Track(const Report& report,
                                   size_t camera_idx,
                                   bool focal_length) {
  std::vector<Eigen::Vector2d> track;
  std::vector<CameraValues> values;
  std::vector<double> days;
  for (size_t i = 0; i < report.earlier.size(); ++i) {
    if (!Knows(report.earlier[i], camera_idx)) continue;
    values.push_back(report.earlier[i].cameras[camera_idx]);
    days.push_back(static_cast<double>(i));
  }
  values.push_back(Values(report.cameras[camera_idx]));
  days.push_back(static_cast<double>(report.earlier.size()));
  const PinholeValues first = ToPinhole(values.front());
  for (size_t i = 0; i < values.size(); ++i) {
    const PinholeValues value = ToPinhole(values[i]);
    track.emplace_back(
        days[i],
        focal_length ? 1000.0 * (value.focal_length / first.focal_length - 1.0)
                     : (value.principal_point - first.principal_point).norm());
  }
  return track;
}

std::string TracksPlot(const Report& report,
                       bool focal_length,
                       const std::string& title,
                       const std::string& label) {
  double low = 0.0;
  double high = 0.0;
  std::vector<std::vector<Eigen::Vector2d>> tracks;
  for (size_t i = 0; i < report.cameras.size(); ++i) {
    tracks.push_back(Track(report, i, focal_length));
    for (const Eigen::Vector2d& point : tracks.back()) {
      low = std::min(low, point.y());
      high = std::max(high, point.y());
    }
  }
  const double margin = std::max(0.1, 0.08 * (high - low));
  Plot plot(title,
            {"results, oldest first; the last is this one",
             -0.2,
             static_cast<double>(report.earlier.size()) + 0.2},
            {label, low - margin, high + margin});
  plot.HideXTicks();
  for (size_t i = 0; i < tracks.size(); ++i) {
    const std::optional<CameraDrift>& drift = report.earlier.back().drifts[i];
    const bool is_unusual = drift && drift->is_unusual;
    plot.AddLine(tracks[i], is_unusual ? "unusual" : "thin");
    for (const Eigen::Vector2d& point : tracks[i]) {
      plot.AddDot(point,
                  is_unusual ? "unusual" : "small",
                  report.cameras[i].name,
                  is_unusual && point == tracks[i].back());
    }
  }
  return Figure(plot.ToSvg(), title);
}

}  // namespace

std::string ChangesSection(const Report& report) {
  std::string content;
  for (size_t i = report.earlier.size(); i-- > 0;) {
    const Comparison& earlier = report.earlier[i];
    content += Folded(
        "Since " + EscapeHtml(earlier.label) +
            (earlier.created.empty() ? "" : ", " + EscapeHtml(earlier.created)),
        Since(report, earlier),
        i + 1 == report.earlier.size());
  }
  const bool is_same = HasSameValues(report.start, report.rig);
  if (!is_same && !report.rig.cameras.empty()) {
    content += Folded("Since RIG, the file with the known extrinsics",
                      Since(report, report.rig));
  }
  content += Folded(is_same ? "Since the start, which is RIG's calibration"
                            : "Since the start",
                    Since(report, report.start),
                    report.earlier.empty());
  return "<section id=\"changes\"><h2>What has changed</h2>\n<p>&plusmn; is "
         "the standard deviation of the change; a change of less than 3 times "
         "that may be chance. <b>Unusual</b> are cameras that have changed far "
         "more than the others of this array.</p>\n" +
         content + LargestDisplacements(report) + "</section>\n";
}

std::string HistorySection(const Report& report) {
  if (report.earlier.size() < 2) return "";
  std::string list;
  for (const Comparison& earlier : report.earlier) {
    list +=
        "<li>" + EscapeHtml(earlier.label) +
        (earlier.created.empty() ? ""
                                 : " (" + EscapeHtml(earlier.created) + ")") +
        "</li>";
  }
  std::vector<std::vector<std::string>> rows;
  for (size_t i = 0; i < report.cameras.size(); ++i) {
    std::vector<std::string> row = {EscapeHtml(report.cameras[i].name)};
    for (const Comparison& earlier : report.earlier) {
      row.push_back(Knows(earlier, i)
                        ? Fixed(ToPinhole(earlier.cameras[i]).focal_length, 2)
                        : Fixed(NAN, 2));
    }
    row.push_back(Fixed(ToPinhole(Values(report.cameras[i])).focal_length, 2));
    rows.push_back(row);
  }
  std::vector<std::string> heads = {"focal length (px)"};
  for (const Comparison& earlier : report.earlier) {
    heads.push_back(EscapeHtml(earlier.label));
  }
  heads.push_back("now");
  return "<section id=\"history\"><h2>History of every camera</h2>\n<p>One "
         "line per camera, since the first result that has it.</p><ol>" +
         list + "<li>this result</li></ol>\n<div class=\"figures wide\">" +
         TracksPlot(report, true, "Focal lengths", "change (&permil;)") +
         TracksPlot(report,
                    false,
                    "Principal points",
                    "distance from the first (px)") +
         "</div>\n" + Folded("Table of all cameras", Table(heads, rows)) +
         "</section>\n";
}

}  // namespace mfir
