// Cameras that have changed more than the others, and cameras whose poses in
// the frames are not those of RIG: what a camera that was bumped looks like.

#pragma once

#include <optional>
#include <vector>

#include <Eigen/Core>

#include "src/scene/estimate.h"
#include "src/scene/scene.h"

namespace mfir {

// Change of the intrinsics of a camera.
struct CameraDrift {
  double focal_permille = 0.0;                                // mean of fx, fy
  Eigen::Vector2d principal_point = Eigen::Vector2d::Zero();  // px
  // Of focal length and principal point, as below.
  double focal_stds = 0.0;
  double principal_point_stds = 0.0;
  // Median size of the other cameras' changes: permille, px per axis.
  double others_focal_permille = 0.0;
  double others_principal_point = 0.0;
  bool is_unusual = false;
};

// Intrinsics of a camera before; empty: not known, no drift.
using DriftReference = std::vector<std::vector<double>>;

// Change of the intrinsics since `reference` (by camera), relative to those of
// the other cameras, in robust standard deviations:
//
//   z_i = |d_i - m_i| / sqrt(w_i^2 s_i^2 + floor^2),
//
// with m_i the median of the other cameras' changes d and s_i the standard
// deviation of their (d - m_i) / w without the largest tenth of them (at least
// one: another camera may be wrong, too), made consistent for normal drift. A
// camera with fewer observations n than the median camera has errors that are
// larger by w = sqrt(median / n), at its start and in the end. The floors are
// 0.5 permille and 0.25 px. Principal points: both axes have the same s_i, z is
// that of the larger one. A drift is unusual above 5 + 45 / (number of other
// cameras) for focal lengths and 5 + 15 / (number) for principal points: few
// cameras tell little about what is usual. nullopt for cameras without
// reference or model; with less than four others nothing is compared.
std::vector<std::optional<CameraDrift>> FindDrifts(
    const std::vector<RigCamera>& cameras,
    const std::vector<size_t>& num_observations,
    const DriftReference& reference);

// Rotation of a camera in the frames against RIG.
struct PoseDisagreement {
  double angle_deg = 0.0;    // of the median rotation vector over the frames
  double scatter_deg = 0.0;  // robust standard deviation per axis
  double others_deg = 0.0;   // median angle of the other cameras
  bool is_moved = false;
};

// Compares the poses of the aligned frames' images, as `estimate` has them,
// with those of the scene's cameras. A camera is moved if its angle is above
// 0.05 degrees, 4 times its scatter and 5 times the angle of the other cameras
// (w as above times that, for a camera with few observations), in most of the
// frames that it is in, and if it has 30 observations at least. Frames whose poses are RIG's own tell
// nothing.
std::vector<PoseDisagreement> FindPoseDisagreements(const Scene& scene,
                                                    const Estimate& estimate);

}  // namespace mfir
