#include "src/report/residuals.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace mfir {
namespace {

// Cell of a keypoint; those outside of the image count at its border.
size_t CellIdx(const ReportCamera& camera, const Eigen::Vector2d& keypoint) {
  const double x = keypoint.x() / static_cast<double>(camera.width);
  const double y = keypoint.y() / static_cast<double>(camera.height);
  const auto column = static_cast<size_t>(std::clamp(
      std::floor(x * kResidualColumns), 0.0, kResidualColumns - 1.0));
  const auto row = static_cast<size_t>(
      std::clamp(std::floor(y * kResidualRows), 0.0, kResidualRows - 1.0));
  return row * kResidualColumns + column;
}

}  // namespace

Eigen::Vector2d ProjectPoint(const CameraModel& model,
                             const std::vector<double>& params,
                             const Rigid3& cam_from_world,
                             const Eigen::Vector3d& xyz) {
  constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
  Eigen::Vector2d xy(kNaN, kNaN);
  const Eigen::Vector3d point = cam_from_world * xyz;
  if (point.z() <= 0.0) return xy;
  model.Project(
      params.data(), point.x() / point.z(), point.y() / point.z(), xy.data());
  return xy;
}

void AddResidual(size_t camera_idx,
                 const Eigen::Vector2d& keypoint,
                 const Eigen::Vector2d& residual,
                 Report* report) {
  ReportCamera& camera = report->cameras[camera_idx];
  ResidualCell& cell = camera.residuals.cells[CellIdx(camera, keypoint)];
  ++cell.num_observations;
  if (residual.norm() <= report->max_inlier_px) {
    ++cell.num_inliers;
    cell.sum += residual;
  }
  ResidualHistogram& histogram = report->histogram;
  for (const double component : residual) {
    const double bin = std::abs(component) / histogram.bin_width;
    if (bin < static_cast<double>(histogram.counts.size())) {
      ++histogram.counts[static_cast<size_t>(bin)];
    } else {
      ++histogram.num_larger;
    }
  }
}

}  // namespace mfir
