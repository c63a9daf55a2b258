// The tilt of the surface at a keypoint, from how the patch around it looks in
// several views.

#pragma once

#include <cstddef>
#include <vector>

#include <Eigen/Core>

#include "src/patches/patch_backend.h"
#include "src/patches/patch_warp.h"

namespace mfir {

// Another view of the patch.
struct SlopeView {
  size_t image_idx = 0;
  PatchMap map;
  // Where the patch is believed to be. It is free to move: the tilt must not
  // follow from errors of the geometry.
  Eigen::Vector2d xy;
};

struct SlopeProblem {
  const ReferencePatch* reference = nullptr;
  const PatchTemplate* patch = nullptr;
  size_t template_idx = 0;  // of `patch`, to the backend
  std::vector<SlopeView> views;
  // Result: the slope (ReferencePatch) with which all views fit best: the best
  // of a grid of tilts, then Gauss-Newton over the slope and all positions. The
  // facing slope where no view shows the patch.
  Eigen::Vector2d slope;
};

// Solves all problems, step by step together, so that a GPU has enough to do.
void EstimateSlopes(int num_threads,
                    PatchBackend* backend,
                    std::vector<SlopeProblem>* problems);

}  // namespace mfir
