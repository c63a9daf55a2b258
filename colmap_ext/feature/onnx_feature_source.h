// Descriptor maps of a network.

#pragma once

#include <memory>
#include <string>

#include "src/dense/dense_feature_options.h"
#include "src/dense/dense_features.h"

namespace mfir {

// Features of the fully convolutional network in options.path. Input: 1 x (3 or
// 1) x height x width, multiples of options.tile_alignment; output: 1 x
// channels x height / stride x width / stride. Below and right of the image its
// border pixels are repeated. Only tiles with keypoints are computed.
//
// Throws InputError for a file that is not such a network, UsageError for
// options that do not suit it. use_gpu and gpu_index: see Network.
std::unique_ptr<DenseFeatureSource> MakeOnnxFeatureSource(
    const OnnxFeatureOptions& options,
    int patch_size,
    int num_threads,
    const std::string& image_path,
    int use_gpu = -1,
    int gpu_index = -1);

}  // namespace mfir
