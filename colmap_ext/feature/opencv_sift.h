// SIFT by OpenCV, as a feature extractor of COLMAP.

#pragma once

#include <memory>

#include "colmap_ext/host/feature.h"

namespace mfir {

// Whether OpenCV's SIFT can do what the options ask for: on the CPU, from
// octave -1, with orientations, without affine shape and domain-size pooling.
bool OpenCVSiftSupports(const host::FeatureExtractionOptions& options);

// The same keypoints as COLMAP's extractor (VLFeat), but for rounding and
// orders of magnitude of time: the thresholds, the number of octaves and of
// orientations mean the same, keypoints are in COLMAP's pixels (the centre of
// the top-left pixel is (0.5, 0.5)), descriptors have its layout and
// normalisation, so that databases may mix both. Beyond max_num_features those
// with the largest contrast are kept.
//
// Memory: about 60 bytes per pixel of the image, times 4 for octave -1.
std::unique_ptr<host::FeatureExtractor> MakeOpenCVSift(
    const host::FeatureExtractionOptions& options);

}  // namespace mfir
