#include <algorithm>
#include <cmath>

#include <Eigen/Dense>

#include "src/report/camera_maps.h"
#include "src/report/health.h"
#include "src/report/html.h"
#include "src/report_page/sections.h"

namespace mfir {
namespace {

using Json = nlohmann::ordered_json;

// The picture is a unit around the origin: four digits are a tenth of a pixel.
double Rounded(double value) { return std::round(value * 1e4) / 1e4; }

Json ToJson(const Eigen::Vector3d& point) {
  return {Rounded(point.x()), Rounded(point.y()), Rounded(point.z())};
}

// Coordinates of the picture: the array around the origin in unit size, z up as
// most cameras have it.
struct View {
  Eigen::Vector3d center = Eigen::Vector3d::Zero();
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  double scale = 1.0;

  Eigen::Vector3d operator()(const Eigen::Vector3d& point) const {
    return scale * (rotation * (point - center));
  }
};

View MakeView(const Report& report) {
  View view;
  Eigen::Vector3d up = Eigen::Vector3d::Zero();
  for (const ReportCamera& camera : report.cameras) {
    view.center += camera.cam_from_world.Center() /
                   static_cast<double>(report.cameras.size());
    up -= camera.cam_from_world.rotation.conjugate() * Eigen::Vector3d::UnitY();
  }
  double sum = 0.0;
  for (const ReportCamera& camera : report.cameras) {
    sum += (camera.cam_from_world.Center() - view.center).squaredNorm() /
           static_cast<double>(report.cameras.size());
  }
  if (sum > 0.0) view.scale = 1.0 / std::sqrt(sum);
  if (up.norm() > 1e-6) {
    view.rotation =
        Eigen::Quaterniond::FromTwoVectors(up, Eigen::Vector3d::UnitZ())
            .toRotationMatrix();
  }
  return view;
}

// Centre, and the corners of the image at a distance.
Json CameraJson(const Report& report, const View& view, size_t camera_idx) {
  constexpr double kDepth = 0.14;
  const ReportCamera& camera = report.cameras[camera_idx];
  const PinholeValues pinhole = ToPinhole(Values(camera));
  const Eigen::Vector3d center = camera.cam_from_world.Center();
  Json corners = Json::array();
  const auto width = static_cast<double>(camera.width);
  const auto height = static_cast<double>(camera.height);
  for (const auto& [x, y] : std::vector<std::pair<double, double>>{
           {0.0, 0.0}, {width, 0.0}, {width, height}, {0.0, height}}) {
    Eigen::Vector3d ray(
        (x - pinhole.principal_point.x()) / pinhole.focal_length,
        (y - pinhole.principal_point.y()) / pinhole.focal_length,
        1.0);
    // Wide lenses stay in the picture.
    ray.head<2>() *= std::min(1.0, 1.2 / ray.head<2>().norm());
    corners.push_back(ToJson(
        view(center + kDepth / view.scale *
                          (camera.cam_from_world.rotation.conjugate() * ray))));
  }
  return {{"name", camera.name},
          {"health", HealthClass(CameraHealth(report, camera_idx))},
          {"center", ToJson(view(center))},
          {"corners", corners}};
}

Json PointsJson(const Report& report, const View& view) {
  // Far outliers would make the picture small.
  constexpr double kMaxDistance = 4.0;
  Json points = Json::array();
  for (const ScenePoint& point : report.points) {
    const Eigen::Vector3d xyz = view(point.xyz);
    if (!(xyz.norm() < kMaxDistance)) continue;
    for (int i = 0; i < 3; ++i) points.push_back(Rounded(xyz(i)));
    points.push_back(point.color(0) << 16 | point.color(1) << 8 |
                     point.color(2));
  }
  return points;
}

}  // namespace

std::string ArraySection(const Report& report) {
  const View view = MakeView(report);
  Json cameras = Json::array();
  for (size_t i = 0; i < report.cameras.size(); ++i) {
    cameras.push_back(CameraJson(report, view, i));
  }
  const std::string frame =
      report.frame_names.empty() ? "" : EscapeHtml(report.frame_names.front());
  return "<section id=\"array\"><h2>The array</h2>\n<p class=\"screen\">Drag "
         "to turn, use the buttons or two fingers to zoom, point at a camera "
         "for its name.</p>\n<figure class=\"array\"><canvas "
         "id=\"array-view\" role=\"img\" aria-label=\"The cameras and points "
         "in space\"></canvas><div class=\"buttons screen\"><button "
         "type=\"button\" data-zoom=\"1.25\" aria-label=\"closer\">+</button>"
         "<button type=\"button\" data-zoom=\"0.8\" aria-label=\"farther\">"
         "&minus;</button></div><figcaption>Cameras by health: <i class=\"key "
         "good\"></i> good, <i class=\"key look\"></i> look at it, <i "
         "class=\"key bad\"></i> not usable; points of frame " +
         frame +
         "</figcaption></figure>\n<script "
         "type=\"application/json\" id=\"array-data\">" +
         ScriptJson(
             {{"cameras", cameras}, {"points", PointsJson(report, view)}}) +
         "</script></section>\n";
}

}  // namespace mfir
