// Robust alignment of a frame's own coordinates to the rig's.

#pragma once

#include <limits>
#include <string>
#include <vector>

#include "src/geometry/rigid3.h"

namespace mfir {

struct PoseAlignment {
  // Empty on success, else why the poses cannot be aligned.
  std::string failure;
  Similarity3 target_from_source;
  // One per pose: whether it agrees with the alignment.
  std::vector<bool> inliers;
  size_t num_inliers = 0;
  // Over the inliers, in units of the target.
  double rms_center_error = 0.0;
  // Over all poses, of the larger of the angle (rad) and the distance of the
  // centres relative to the spread of the target. Infinite on failure.
  double median_error = std::numeric_limits<double>::infinity();
};

// Similarity that maps camera poses onto the target poses of the same cameras
// (cam_from_world each, same order). Every pair of cameras gives a hypothesis
// (rotations and distance of the two); the one with the smallest truncated cost
// over all cameras is refined on its inliers. Up to half of the poses may be
// arbitrarily wrong. Rotations make it work where centres alone do not (cameras
// on a line). Deterministic.
PoseAlignment AlignPoses(const std::vector<Rigid3>& source_cams_from_world,
                         const std::vector<Rigid3>& target_cams_from_world);

// Similarity into coordinates in which the camera centres have zero mean and an
// RMS distance of 1000 from it: about the millimetres of the paper's dome, so
// that the weights of the translation prior mean the same for every array.
// Centres more than ten median distances off do not count.
Similarity3 NormalizeRig(const std::vector<Rigid3>& cams_from_world);

Similarity3 Inverse(const Similarity3& b_from_a);
Similarity3 operator*(const Similarity3& c_from_b, const Similarity3& b_from_a);

// The pose of a camera after the world has been moved by new_from_old (rotation
// of the camera and its centre; the scale moves into the translation).
Rigid3 TransformPose(const Similarity3& new_from_old,
                     const Rigid3& cam_from_old);

}  // namespace mfir
