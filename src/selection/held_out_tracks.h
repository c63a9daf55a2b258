// Tracks that take no part in a refinement, to check its result.

#pragma once

#include "src/scene/scene.h"
#include "src/selection/selection.h"

namespace mfir {

// Holds out about `share` of the fitted tracks. The choice depends on the
// track's own keypoints only, not on any name or order. None where nothing
// would be left to fit.
Selection HoldOutTracks(double share, const Scene& scene, Selection selection);

}  // namespace mfir
