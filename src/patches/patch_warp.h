// How a small piece of surface that one view shows looks from another, through
// poses and lenses.

#pragma once

#include <array>
#include <vector>

#include <Eigen/Core>

#include "src/geometry/rigid3.h"
#include "src/patches/patch_alignment_kernels.h"
#include "src/sensor/camera_model.h"

namespace mfir {

// A camera at the instant of a frame.
struct PatchCamera {
  const CameraModel* model = nullptr;
  Rigid3 cam_from_world;
  std::vector<double> params;
};

// Keypoint of the reference view, and the rays around it. The surface through
// it has, at the offset u (px of the reference image) from the keypoint, the
// inverse depth (1 + slope . u) / depth: a plane, as long as distortion is
// linear over the patch.
struct ReferencePatch {
  Rigid3 cam_from_world;
  // Rays (x, y, 1) at the offsets kRayStep * (-1, 0, 1) in u and v, rows of v.
  std::array<Eigen::Vector3d, 9> rays;
  Eigen::Matrix2d ray_jacobian;  // d(x, y) / d(pixel)

  const Eigen::Vector3d& Ray() const { return rays[4]; }
  // Slope of the plane whose normal is the ray: what a view sees straight on.
  Eigen::Vector2d FacingSlope() const;
};

constexpr double kRayStep = 4.0;  // px of the reference image

// False where the lens cannot be inverted.
bool MakeReferencePatch(const PatchCamera& camera,
                        const Eigen::Vector2d& xy,
                        ReferencePatch* reference);

// Slope of the plane through the keypoint whose normal is turned away from the
// ray by the vector `tangent` (its length is the tangent of the angle).
Eigen::Vector2d SlopeOfTilt(const ReferencePatch& reference,
                            const Eigen::Vector2d& tangent);

// First-order map of the patch into another view, for all slopes:
// position(u) = center + (affine + epipole slope^T) u.
struct PatchMap {
  Eigen::Vector2d center;
  Eigen::Matrix2d affine;
  // Derivative of the centre by the logarithm of the inverse depth.
  Eigen::Vector2d epipole;

  Eigen::Matrix2d Affine(const Eigen::Vector2d& slope) const {
    return affine + epipole * slope.transpose();
  }
};

// `depth`: of the keypoint's surface point in the reference camera. False where
// the point is not in front of the camera or where the lens model folds.
bool MakePatchMap(const ReferencePatch& reference,
                  const PatchCamera& camera,
                  double depth,
                  PatchMap* map);

// The map of a slope, with its second order.
bool MakePatchWarp(const ReferencePatch& reference,
                   const PatchCamera& camera,
                   double depth,
                   const Eigen::Vector2d& slope,
                   PatchWarp* warp);

}  // namespace mfir
