// The point that several views show.

#pragma once

#include <cstddef>
#include <vector>

#include <Eigen/Core>

#include "src/patches/patch_warp.h"

namespace mfir {

struct PointObservation {
  size_t camera_idx;
  Eigen::Vector2d xy;
};

// The point that its observations show best, from a nearby one; that one where
// this fails.
Eigen::Vector3d FitPoint(const std::vector<PatchCamera>& cameras,
                         const std::vector<PointObservation>& observations,
                         const Eigen::Vector3d& start);

}  // namespace mfir
