#include "src/report/camera_figures.h"

#include <algorithm>
#include <cmath>

#include "src/report/camera_maps.h"
#include "src/report/html.h"
#include "src/report/svg.h"

namespace mfir {
namespace {

constexpr double kImageWidth = 240.0;  // of an image's picture, SVG units
constexpr int kMapColumns = 12;
constexpr int kMapRows = 8;
// Cells with fewer inliers have no mean residual.
constexpr uint32_t kMinInliers = 3;

double ImageHeight(const ReportCamera& camera) {
  return kImageWidth * static_cast<double>(camera.height) /
         static_cast<double>(std::max<size_t>(1, camera.width));
}

double SvgScale(const ReportCamera& camera) {
  return kImageWidth / static_cast<double>(std::max<size_t>(1, camera.width));
}

std::string ImageSvg(const ReportCamera& camera,
                     const std::string& title,
                     const std::string& content) {
  return Svg(kImageWidth,
             ImageHeight(camera),
             title + " of camera " + camera.name,
             content + "<rect class=\"frame\" x=\"0\" y=\"0\" width=\"" +
                 Coordinate(kImageWidth) + "\" height=\"" +
                 Coordinate(ImageHeight(camera)) + "\"/>");
}

double Quantile(std::vector<double> values, double share) {
  if (values.empty()) return 0.0;
  const auto it =
      values.begin() + static_cast<std::ptrdiff_t>(
                           share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), it, values.end());
  return *it;
}

// Such that a length (px) of `length` is about a cell wide.
double ArrowFactor(const Report& report, double length) {
  std::vector<double> widths;
  for (const ReportCamera& camera : report.cameras) {
    widths.push_back(static_cast<double>(camera.width) / kMapColumns);
  }
  return RoundDown(Quantile(widths, 0.5) / std::max(length, 1e-6));
}

std::vector<Eigen::Vector2d> MeanResiduals(const ResidualMap& map) {
  std::vector<Eigen::Vector2d> means;
  for (const ResidualCell& cell : map.cells) {
    means.push_back(cell.num_inliers < kMinInliers
                        ? Eigen::Vector2d(NAN, NAN)
                        : Eigen::Vector2d(cell.sum / cell.num_inliers));
  }
  return means;
}

std::string ArrowsSvg(const ReportCamera& camera,
                      const std::string& title,
                      const std::vector<Eigen::Vector2d>& pixels,
                      const std::vector<Eigen::Vector2d>& vectors,
                      double factor,
                      const std::string& css_class) {
  const double scale = SvgScale(camera);
  std::vector<Arrow> arrows;
  for (size_t i = 0; i < pixels.size(); ++i) {
    // Around the pixel, so that they stay in the picture at its borders.
    const Eigen::Vector2d half = 0.5 * factor * vectors[i];
    arrows.push_back({(pixels[i] - half) * scale, (pixels[i] + half) * scale});
  }
  return ImageSvg(camera, title, ArrowPath(arrows, css_class));
}

// As "0.12" with two significant digits or so.
std::string Short(double value) {
  if (!std::isfinite(value) || value == 0.0) return Fixed(value, 0);
  const int digits = 1 - static_cast<int>(std::floor(std::log10(value)));
  return Fixed(value, std::clamp(digits, 0, 6));
}

std::string Times(double factor) {
  return factor == 1.0 ? "" : " &times;&nbsp;" + Short(factor);
}

double LargestNorm(const std::vector<Eigen::Vector2d>& vectors) {
  double largest = 0.0;
  for (const Eigen::Vector2d& vector : vectors) {
    if (vector.allFinite()) largest = std::max(largest, vector.norm());
  }
  return largest;
}

std::vector<Eigen::Vector2d> CameraDisplacements(const Report& report,
                                                 size_t camera_idx) {
  const ReportCamera& camera = report.cameras[camera_idx];
  return Displacements(
      MainReference(report).cameras[camera_idx],
      Values(camera),
      GridPoints(camera.width, camera.height, kMapColumns, kMapRows));
}

}  // namespace

const Comparison& MainReference(const Report& report) {
  return report.earlier.empty() ? report.start : report.earlier.back();
}

bool Knows(const Comparison& comparison, size_t camera_idx) {
  return camera_idx < comparison.cameras.size() &&
         comparison.cameras[camera_idx].model != nullptr;
}

FigureScales MakeFigureScales(const Report& report) {
  std::vector<double> residuals;
  std::vector<double> displacements;
  std::vector<double> stds;
  std::vector<double> counts;
  for (size_t i = 0; i < report.cameras.size(); ++i) {
    const ReportCamera& camera = report.cameras[i];
    for (const Eigen::Vector2d& mean : MeanResiduals(camera.residuals)) {
      if (mean.allFinite()) residuals.push_back(mean.norm());
    }
    for (const ResidualCell& cell : camera.residuals.cells) {
      counts.push_back(cell.num_inliers);
    }
    for (const double value : ProjectionStds(
             camera,
             GridPoints(camera.width, camera.height, kMapColumns, kMapRows))) {
      if (std::isfinite(value)) stds.push_back(value);
    }
    if (!Knows(MainReference(report), i)) continue;
    for (const Eigen::Vector2d& vector : CameraDisplacements(report, i)) {
      if (vector.allFinite()) displacements.push_back(vector.norm());
    }
  }
  FigureScales scales;
  scales.residual_factor = ArrowFactor(report, Quantile(residuals, 0.9));
  scales.displacement_factor =
      ArrowFactor(report, Quantile(displacements, 0.9));
  scales.max_std = std::max(1e-9, Quantile(stds, 0.95));
  scales.max_coverage = std::max(1.0, Quantile(counts, 0.95));
  return scales;
}

std::string ResidualFigure(const Report& report,
                           const FigureScales& scales,
                           size_t camera_idx) {
  const ReportCamera& camera = report.cameras[camera_idx];
  const std::vector<Eigen::Vector2d> means = MeanResiduals(camera.residuals);
  return Figure(
      ArrowsSvg(
          camera,
          "Mean residuals",
          GridPoints(
              camera.width, camera.height, kResidualColumns, kResidualRows),
          means,
          scales.residual_factor,
          "arrow"),
      "<b>Mean residuals</b>" + Times(scales.residual_factor) + ", largest " +
          Short(LargestNorm(means)) + "&nbsp;px");
}

std::string CoverageFigure(const Report& report,
                           const FigureScales& scales,
                           size_t camera_idx) {
  const ReportCamera& camera = report.cameras[camera_idx];
  std::vector<double> counts;
  size_t num_empty = 0;
  for (const ResidualCell& cell : camera.residuals.cells) {
    counts.push_back(cell.num_inliers > 0 ? cell.num_inliers : NAN);
    num_empty += cell.num_inliers == 0;
  }
  const double width = kImageWidth / kResidualColumns;
  const double height = ImageHeight(camera) / kResidualRows;
  return Figure(ImageSvg(camera,
                         "Coverage",
                         CellsSvg(counts,
                                  kResidualColumns,
                                  0.0,
                                  scales.max_coverage,
                                  width,
                                  height)),
                "<b>Coverage</b> " +
                    ColorScale("1", Fixed(scales.max_coverage, 0) + "+") +
                    " observations per cell, " +
                    Fixed(100.0 * static_cast<double>(num_empty) /
                              static_cast<double>(counts.size()),
                          0) +
                    "&nbsp;% without");
}

std::string UncertaintyFigure(const Report& report,
                              const FigureScales& scales,
                              size_t camera_idx) {
  const ReportCamera& camera = report.cameras[camera_idx];
  const std::vector<double> stds = ProjectionStds(
      camera, GridPoints(camera.width, camera.height, kMapColumns, kMapRows));
  double largest = NAN;
  for (const double value : stds) {
    if (!(value <= largest)) largest = std::isfinite(value) ? value : largest;
  }
  if (!std::isfinite(largest)) {
    return Figure(ImageSvg(camera, "Uncertainty", ""),
                  "<b>Uncertainty</b> is not known: parameters are "
                  "undetermined");
  }
  return Figure(ImageSvg(camera,
                         "Uncertainty",
                         CellsSvg(stds,
                                  kMapColumns,
                                  0.0,
                                  scales.max_std,
                                  kImageWidth / kMapColumns,
                                  ImageHeight(camera) / kMapRows)),
                "<b>Uncertainty</b> " +
                    ColorScale("0", Short(scales.max_std) + "+ px") +
                    ", largest " + Short(largest) + "&nbsp;px");
}

std::string DisplacementSvg(const Report& report,
                            const FigureScales& scales,
                            size_t camera_idx) {
  const ReportCamera& camera = report.cameras[camera_idx];
  return ArrowsSvg(
      camera,
      "Displacement",
      GridPoints(camera.width, camera.height, kMapColumns, kMapRows),
      CameraDisplacements(report, camera_idx),
      scales.displacement_factor,
      "arrow change");
}

std::string DisplacementFigure(const Report& report,
                               const FigureScales& scales,
                               size_t camera_idx) {
  const Comparison& reference = MainReference(report);
  if (!Knows(reference, camera_idx)) return "";
  return Figure(
      DisplacementSvg(report, scales, camera_idx),
      "<b>Change</b> since " + EscapeHtml(reference.label) +
          Times(scales.displacement_factor) + ", largest " +
          Short(LargestNorm(CameraDisplacements(report, camera_idx))) +
          "&nbsp;px");
}

std::string HistoryFigure(const Report& report, size_t camera_idx) {
  if (report.earlier.size() < 2) return "";
  std::vector<Eigen::Vector2d> track;
  std::vector<double> errors;
  double low = INFINITY;
  double high = -INFINITY;
  for (size_t i = 0; i <= report.earlier.size(); ++i) {
    const bool is_now = i == report.earlier.size();
    if (!is_now && !Knows(report.earlier[i], camera_idx)) continue;
    const CameraValues values = is_now ? Values(report.cameras[camera_idx])
                                       : report.earlier[i].cameras[camera_idx];
    track.emplace_back(static_cast<double>(i), ToPinhole(values).focal_length);
    errors.push_back(2.0 * ToPinholeStds(values).focal_length);
    const double error = std::isfinite(errors.back()) ? errors.back() : 0.0;
    low = std::min(low, track.back().y() - error);
    high = std::max(high, track.back().y() + error);
  }
  const double margin = std::max(0.05, 0.08 * (high - low));
  const std::string& name = report.cameras[camera_idx].name;
  Plot plot("Focal length of camera " + name + " over the results",
            {"results, oldest first",
             -0.2,
             static_cast<double>(report.earlier.size()) + 0.2},
            {"focal length (px)", low - margin, high + margin});
  plot.HideXTicks();
  plot.AddLine(track, "thin");
  for (size_t i = 0; i < track.size(); ++i) {
    plot.AddErrorBar(track[i], errors[i]);
    plot.AddDot(track[i], "", name);
  }
  return Figure(plot.ToSvg(), "<b>History</b> of the focal length");
}

std::string DistortionFigure(const Report& report, size_t camera_idx) {
  const ReportCamera& camera = report.cameras[camera_idx];
  if (camera.model->ExtraParamsIdxs().empty()) return "";
  std::vector<Eigen::Vector2d> after =
      DistortionCurve(Values(camera), camera.width, camera.height);
  std::vector<Eigen::Vector2d> before;
  const Comparison& reference = MainReference(report);
  if (Knows(reference, camera_idx)) {
    before = DistortionCurve(
        reference.cameras[camera_idx], camera.width, camera.height);
  }
  double low = 0.0;
  double high = 0.0;
  double radius = 1.0;
  for (const auto& curve : {before, after}) {
    for (const Eigen::Vector2d& point : curve) {
      low = std::min(low, point.y());
      high = std::max(high, point.y());
      radius = std::max(radius, point.x());
    }
  }
  const double margin = std::max(0.5, 0.08 * (high - low));
  Plot plot("Distortion of camera " + camera.name,
            {"distance from the principal point (px)", 0.0, radius},
            {"shift (px)", low - margin, high + margin});
  plot.AddLine(before, "before");
  plot.AddLine(after, "after");
  plot.AddLegend("before", "before");
  plot.AddLegend("now", "after");
  return Figure(plot.ToSvg(), "<b>Distortion</b> along the radius");
}

}  // namespace mfir
