// Where the intrinsics of a refinement start.

#pragma once

#include <vector>

#include "src/refinement/options.h"
#include "src/scene/estimate.h"
#include "src/scene/scene.h"

namespace mfir {

// `cameras` with the median of the intrinsics of their images in `frames`,
// those of all ranks; cameras without an image stay as they are.
std::vector<RigCamera> WithMedianIntrinsics(
    const Scene& scene,
    const std::vector<FrameEstimate>& frames,
    std::vector<RigCamera> cameras);

// Sets the intrinsics of the rig's cameras, in the scene (for priors) and in
// the estimate, to the median of their frames, and parameters that are not
// refined to the same value in all frames. Images whose focal length is not 0.1
// to 10 times the larger image side, whose principal point is outside of the
// image, or whose distortion changes distances by more than a factor of
// three, do not
// count; a camera that has no others starts from the array's median focal
// length and distortion and the image centre.
SceneEstimate InitializeIntrinsics(const MultiFrameOptions& options,
                                   SceneEstimate capture);

}  // namespace mfir
