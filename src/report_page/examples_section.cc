#include <algorithm>
#include <cmath>

#include "src/report/html.h"
#include "src/report/svg.h"
#include "src/report_page/sections.h"
#include "src/util/median.h"

namespace mfir {
namespace {

// Lines from keypoints to projections, drawn longer by `factor`.
std::string Lines(const ExampleImage& example,
                  Eigen::Vector2d ExamplePoint::*projection,
                  double factor,
                  const std::string& css_class) {
  std::string path;
  for (const ExamplePoint& point : example.points) {
    const Eigen::Vector2d end =
        point.keypoint + factor * (point.*projection - point.keypoint);
    if (!end.allFinite()) continue;
    path += "M" + Coordinate(point.keypoint.x()) + " " +
            Coordinate(point.keypoint.y()) + "L" + Coordinate(end.x()) + " " +
            Coordinate(end.y());
  }
  return "<path class=\"" + css_class + "\" d=\"" + path + "\"/>";
}

// Such that the median line is 4 % of the image's width.
double Factor(const std::vector<double>& lengths, double width) {
  if (lengths.empty()) return 1.0;
  return std::max(1.0,
                  RoundDown(0.04 * width / std::max(Median(lengths), 1e-3)));
}

std::string ExampleFigure(const Report& report, const ExampleImage& example) {
  const ReportCamera& camera = report.cameras[example.camera_idx];
  const auto width = static_cast<double>(camera.width);
  const auto height = static_cast<double>(camera.height);
  std::vector<double> before;
  std::vector<double> after;
  for (const ExamplePoint& point : example.points) {
    if (!point.projection_before.allFinite()) continue;
    before.push_back((point.projection_before - point.keypoint).norm());
    after.push_back((point.projection_after - point.keypoint).norm());
  }
  if (before.empty()) return "";
  const double factor_before = Factor(before, width);
  const double factor_after = Factor(after, width);
  std::string dots;
  for (const ExamplePoint& point : example.points) {
    dots += "M" + Coordinate(point.keypoint.x()) + " " +
            Coordinate(point.keypoint.y()) + "h0";
  }
  const std::string svg =
      "<svg class=\"example\" style=\"--unit:" + Coordinate(width / 400.0) +
      "px\" viewBox=\"0 0 " + Coordinate(width) + " " + Coordinate(height) +
      "\" role=\"img\" aria-label=\"Image of camera " +
      EscapeHtml(camera.name) + "\"><image width=\"" + Coordinate(width) +
      "\" height=\"" + Coordinate(height) +
      "\" href=\"data:image/jpeg;base64," + example.jpeg_base64 + "\"/>" +
      Lines(example,
            &ExamplePoint::projection_before,
            factor_before,
            "example-before") +
      Lines(example,
            &ExamplePoint::projection_after,
            factor_after,
            "example-after") +
      "<path class=\"keypoints\" d=\"" + dots + "\"/></svg>";
  return Figure(
      svg,
      "<b>" + EscapeHtml(camera.name) + "</b>, frame " +
          EscapeHtml(example.frame_name) +
          ". <i class=\"key before\"></i>&nbsp;before, lines &times;&nbsp;" +
          Fixed(factor_before, 0) + ", median " + Fixed(Median(before), 2) +
          "&nbsp;px. <i class=\"key after\"></i>&nbsp;now, &times;&nbsp;" +
          Fixed(factor_after, 0) + ", median " + Fixed(Median(after), 3) +
          "&nbsp;px");
}

}  // namespace

std::string ExamplesSection(const Report& report) {
  std::string figures;
  for (const ExampleImage& example : report.examples) {
    figures += ExampleFigure(report, example);
  }
  if (figures.empty()) {
    figures = "<p>" + EscapeHtml(report.examples_remark) + "</p>";
  } else {
    figures =
        "<p>The worst, the median and the best camera of a frame. Dots are "
        "keypoints; lines lead from there to the projections of the refined "
        "points, with the intrinsics of the start and with those of "
        "today. Lines are drawn longer than they are, by the factor in the "
        "caption. Inliers only.</p><div class=\"figures examples\">" +
        figures + "</div>";
  }
  return "<section id=\"examples\"><h2>Example images</h2>\n" + figures +
         "</section>\n";
}

}  // namespace mfir
