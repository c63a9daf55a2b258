// Ways of writing camera poses other than COLMAP's.

#pragma once

#include <string>
#include <vector>

#include <Eigen/Core>

#include "src/geometry/rigid3.h"

namespace mfir {

// How a pose (R, t) of a file is to be read. COLMAP's is world-to-camera,
// x_camera = R x_world + t, in a right-handed world, with camera axes x right,
// y down, z forward.
struct PoseConvention {
  // The pose is camera-to-world.
  bool is_camera_to_world = false;
  // -1: this axis of the camera points the other way. Turning one or all makes
  // a mirror image of the camera, whose pose is a rotation only in a mirrored
  // (left-handed) world.
  Eigen::Vector3d axes = Eigen::Vector3d::Ones();

  bool IsMirrored() const { return axes.prod() < 0.0; }

  // COLMAP's pose. A mirrored world is mirrored back along its z axis; any
  // other axis would give the same but for a rotation of the world.
  Rigid3 ToColmap(const Rigid3& pose) const;

  // E.g. "camera-to-world poses with OpenGL's camera axes (y up, z backward)".
  std::string Description() const;
  // Of ToColmap, e.g. "R' = F R, t' = F t with F = diag(1, -1, -1)".
  std::string Formula() const;
};

// All but COLMAP's own, the more usual first.
const std::vector<PoseConvention>& OtherPoseConventions();

// The convention in which the poses of RIG's cameras fit the poses that a
// reconstruction gives them (same order) at least three times better than as
// they are, and well; null if there is none. A pointer into
// OtherPoseConventions(). The reconstruction has coordinates of its own, so
// cameras on a line or in a plane may fit in several conventions: then all the
// same world but for its orientation, and null.
const PoseConvention* FindPoseConvention(
    const std::vector<Rigid3>& cams_from_world,
    const std::vector<Rigid3>& rig_cams_from_world);

// What RIG holds and how to convert it, in sentences.
std::string PoseConventionAdvice(const PoseConvention& convention);

}  // namespace mfir
