// The option static_points: what becomes of the tracks of static points
// (static_point_search.h) in a refinement.

#pragma once

#include <cstddef>
#include <string>

#include "src/scene/scene.h"
#include "src/selection/selection.h"

namespace mfir {

struct StaticPointStatistics {
  size_t num_points = 0;
  // That show static points, in all frames.
  size_t num_tracks = 0;
  // Share of the observations that show static points.
  double observation_share = 0.0;
};

// Gives the tracks of static points their role. "merge": one track takes their
// place, with the median of their keypoints in each camera. It belongs to the
// last frame that has images of most of its cameras, and among those to the one
// that sees it in most, the first of several. "drop": no track of a static
// point takes part. "keep": all are fitted; RefineFixedExtrinsics takes the
// tracks of a static point for one piece of evidence in the covariance.
//
// The statistics are those of all ranks; "merge" is for one process. Throws
// InputError if "drop" leaves nothing.
Selection SelectStaticPoints(const std::string& treatment,
                             const Scene& scene,
                             StaticPointStatistics* statistics,
                             int num_threads = -1);

}  // namespace mfir
