// How far from their epipolar lines the right matches of the pairs of a frame
// are.

#pragma once

#include <utility>
#include <vector>

#include <Eigen/Core>

#include "colmap_ext/host/feature.h"
#include "src/geometry/epipolar_tolerance.h"
#include "src/scene/scene.h"

namespace mfir {

// Keypoints of image 1 and 2.
using IndexMatches = std::vector<std::pair<uint32_t, uint32_t>>;

// An image as far as matching is concerned.
struct MatchingImage {
  host::image_t image_id = 0;
  size_t camera_idx = 0;
  double focal_length = 0.0;  // pixels per radian
  host::FeatureKeypoints keypoints;
  std::vector<Eigen::Vector3d> rays;  // unit, by keypoint
  // Of SIFT, one per keypoint; else empty.
  host::FeatureDescriptors descriptors;
};

struct MatchingPair {
  const MatchingImage* image1 = nullptr;
  const MatchingImage* image2 = nullptr;
  Eigen::Matrix3d essential_matrix;
  double max_error = 0.0;  // pixels, cap of the tolerance
  // Whether matches are looked for along epipolar lines.
  bool is_guided = false;
  host::FeatureMatches stored_matches;  // of the database

  // What the tolerance is learnt from: matches of a sample of the keypoints, or
  // else those of the database; their epipolar errors (pixels); and of random
  // pairs of keypoints the share below max_error among those that could have
  // been matches.
  IndexMatches sample;
  std::vector<double> errors;
  double random_share = 1.0;

  EpipolarTolerance estimate;
  double tolerance = 0.0;        // pixels
  host::FeatureMatches matches;  // within
};

// EpipolarError of two keypoints, or max() where it is not defined: outside of
// what the lens model can invert.
double MatchError(const MatchingPair& pair, size_t idx1, size_t idx2);

// Sets errors, random_share and the estimate from `sample`. With is_guided, the
// candidates of these matches were all keypoints within max_error, else all
// keypoints.
void EstimateTolerance(MatchingPair* pair);

// Whether the pair has enough right matches to tell its own tolerance.
bool HasOwnTolerance(const MatchingPair& pair);

// Sets the tolerances: pairs with few matches take that of the others.
void SetTolerances(std::vector<MatchingPair>* pairs);

// Whether that many of the sample's matches within the tolerance could be
// chance, in a frame of num_pairs pairs.
bool CouldBeChance(const MatchingPair& pair, size_t num_pairs);

}  // namespace mfir
