// What intrinsics, their changes and their uncertainty do in the image.

#pragma once

#include <optional>
#include <vector>

#include <Eigen/Core>

#include "src/report/report.h"

namespace mfir {

// Centres of the cells of a grid over an image, pixels, row by row.
std::vector<Eigen::Vector2d> GridPoints(size_t width,
                                        size_t height,
                                        int columns,
                                        int rows);

// Where the rays of `pixels` under `before` are seen under `after`, less the
// pixels: the displacement in the image, px. Not finite where a model ends.
std::vector<Eigen::Vector2d> Displacements(
    const CameraValues& before,
    const CameraValues& after,
    const std::vector<Eigen::Vector2d>& pixels);

// Standard deviation (px) of the projection of the rays of `pixels` in its
// worst direction, sqrt of the larger eigenvalue of J S J^T, where J is the
// derivative of the projection by the intrinsics and S their covariance. Pose
// and point are taken for known. NaN where S is.
std::vector<double> ProjectionStds(const ReportCamera& camera,
                                   const std::vector<Eigen::Vector2d>& pixels);

// Distortion as shift along the radius: distance of a pixel from the principal
// point (x, px), and how much farther it is than the same ray of a lens without
// distortion and with the same focal length (y, px), from the principal point
// to the farthest corner. The lens without distortion is f tan(angle), or f *
// angle for fisheye models.
std::vector<Eigen::Vector2d> DistortionCurve(const CameraValues& camera,
                                             size_t width,
                                             size_t height);

// Mean of the focal lengths, and the principal point.
struct PinholeValues {
  double focal_length = 0.0;
  Eigen::Vector2d principal_point = Eigen::Vector2d::Zero();
};
PinholeValues ToPinhole(const CameraValues& camera);

// Standard deviations of the same: of the focal lengths and of the coordinates
// of the principal point, root mean square of both. NaN where they are not
// known.
struct PinholeStds {
  double focal_length = 0.0;
  double principal_point = 0.0;
};
PinholeStds ToPinholeStds(const CameraValues& camera);

// The camera as it is now.
CameraValues Values(const ReportCamera& camera);

}  // namespace mfir
