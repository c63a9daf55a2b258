// Dense features of a capture.

#pragma once

#include <functional>
#include <string>

#include "src/refinement/options.h"
#include "src/scene/scene.h"

namespace mfir {

// The scene with the cost maps of all observations from the source that
// options.dense_features names, one image at a time, and, where the loss is
// estimated from the data, the features' keypoints. `log` gets a line per
// frame. The scene stays as it is for "none". Throws InputError, UsageError and
// OutputError as MakeDenseFeatureSource and ComputeCostMaps.
Scene AddDenseFeatures(const MultiFrameOptions& options,
                       const std::string& image_path,
                       const std::function<void(const std::string&)>& log,
                       Scene scene);

}  // namespace mfir
