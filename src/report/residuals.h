// Residuals of observations, collected for a report.

#pragma once

#include <vector>

#include <Eigen/Core>

#include "src/report/report.h"

namespace mfir {

// Pixel of a point of the world; NaN behind the camera.
Eigen::Vector2d ProjectPoint(const CameraModel& model,
                             const std::vector<double>& params,
                             const Rigid3& cam_from_world,
                             const Eigen::Vector3d& xyz);

// Adds the residual (projection - keypoint, px) of an observation to the map of
// its camera and to the histogram. One that is not finite counts as an outlier.
void AddResidual(size_t camera_idx,
                 const Eigen::Vector2d& keypoint,
                 const Eigen::Vector2d& residual,
                 Report* report);

}  // namespace mfir
