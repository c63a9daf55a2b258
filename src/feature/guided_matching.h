// Matching of features between cameras with known epipolar geometry.

#pragma once

#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include <Eigen/Core>

#include "src/scene/scene.h"

namespace mfir {

// The features of one image. Rays that are not finite (outside of what the lens
// model can invert) match nothing.
struct ImageFeatures {
  Rigid3 cam_from_world;
  double focal_length = 0.0;  // pixels per radian
  // By keypoint: unit rays in camera coordinates, and 128 bytes of SIFT,
  // scaled to length 512.
  const std::vector<Eigen::Vector3d>* rays = nullptr;
  const uint8_t* descriptors = nullptr;
};

// The same names and meaning as in COLMAP's SiftMatchingOptions.
struct GuidedMatchingOptions {
  double max_error = 4.0;     // epipolar, pixels (EpipolarError)
  double max_distance = 0.7;  // between descriptors, radians
  double max_ratio = 0.8;     // of the smallest two distances
  bool cross_check = true;
  // Only every so-manieth keypoint of image 1 takes part: a sample.
  size_t query_stride = 1;
};

// Pairs of keypoints (idx1, idx2) whose descriptors match, among those within
// max_error of each other's epipolar lines, on the same side of the baseline,
// only: COLMAP's guided matching (feature/sift.cc, MatchGuidedSiftFeaturesCPU),
// but with time and memory that follow the number of such candidates, not the
// product of the numbers of keypoints.
std::vector<std::pair<uint32_t, uint32_t>> MatchGuided(
    const GuidedMatchingOptions& options,
    const ImageFeatures& image1,
    const ImageFeatures& image2);

}  // namespace mfir
