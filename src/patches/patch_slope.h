// The tilt of the surface at a keypoint, from how the patch around it looks in
// several views.

#pragma once

#include <vector>

#include <Eigen/Core>

#include "src/patches/patch_alignment.h"
#include "src/patches/patch_warp.h"

namespace mfir {

// Another view of the patch.
struct SlopeView {
  const SplineImage* image = nullptr;
  PatchMap map;
  // Where the patch is believed to be. It is free to move: the tilt must not
  // follow from errors of the geometry.
  Eigen::Vector2d xy;
};

// Slope (ReferencePatch) with which all views fit best: the best of a grid of
// tilts, then Gauss-Newton over the slope and all positions. The facing slope
// where no view shows the patch.
Eigen::Vector2d EstimateSlope(const ReferencePatch& reference,
                              const PatchTemplate& patch,
                              const std::vector<SlopeView>& views);

}  // namespace mfir
