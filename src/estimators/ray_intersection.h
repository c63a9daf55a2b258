// Starts of a point: where the rays of its observations meet.

#pragma once

#include <vector>

#include <Eigen/Core>

#include "src/residuals/linearization.h"
#include "src/scene/estimate.h"
#include "src/scene/scene.h"

namespace mfir {

// {center + distance * direction}; `direction` has unit length.
struct Ray {
  Eigen::Vector3d center;
  Eigen::Vector3d direction;
};

// The ray of a pixel, in world coordinates. False without: distortion that has
// no inverse there.
inline bool UnprojectRay(const CameraModel& model,
                         const CameraState& state,
                         const Eigen::Vector2d& xy,
                         Ray* ray) {
  Eigen::Vector3d direction(0.0, 0.0, 1.0);
  model.Unproject(state.params.data(), xy.x(), xy.y(), direction.data());
  ray->center = -(state.rotation.transpose() * state.translation);
  ray->direction = (state.rotation.transpose() * direction).normalized();
  return ray->direction.allFinite();
}

// Points that most of the rays may pass through although others pass far from
// it: the point closest to all rays, by iteratively reweighted least squares
// (Cauchy on distance to the ray over distance to the camera), then those
// closest to pairs of rays (all pairs of few rays, each ray in two pairs of
// many). Parallel rays give none.
std::vector<Eigen::Vector3d> RayIntersections(const std::vector<Ray>& rays);

// Moves points that are behind cameras to where their rays meet, if that is in
// front of more of them. `states`: of the rig's cameras.
void MovePointsToTheFront(const std::vector<CameraState>& states,
                          const Scene& scene,
                          int num_threads,
                          Estimate* estimate);

}  // namespace mfir
