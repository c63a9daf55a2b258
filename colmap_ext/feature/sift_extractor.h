// The SIFT of src/feature as a feature extractor of COLMAP.

#pragma once

#include <memory>

#include "colmap_ext/host/feature.h"

namespace mfir {

// Whether it can do what the options ask for: on the CPU, without affine shape
// and domain-size pooling.
bool BuiltInSiftSupports(const host::FeatureExtractionOptions& options);

// Gives what COLMAP's extractor gives with these options, but for rounding, in
// a fraction of the time. Memory: about 120 bytes per pixel of the image.
std::unique_ptr<host::FeatureExtractor> MakeBuiltInSift(
    const host::FeatureExtractionOptions& options);

}  // namespace mfir
