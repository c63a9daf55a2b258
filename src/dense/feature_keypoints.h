// Where the reference feature of a track is found in each of its images: the
// minimum of the cost map, as a second measurement beside the keypoint.

#pragma once

#include <Eigen/Core>

#include "src/scene/scene.h"

namespace mfir {

// Minimum of a cost map near a keypoint: squared distance of the features =
// min_squared_distance + (xy - minimum)^T sharpness (xy - minimum).
struct CostMapMinimum {
  Eigen::Vector2d xy;           // image coordinates
  Eigen::Matrix2d sharpness;    // positive definite, 1/px^2
  double min_squared_distance;  // of features
};

// By least squares over 5 x 5 elements around the smallest distance within 4
// elements of `keypoint`. False if there is no minimum there.
bool FindCostMapMinimum(const CostMaps& cost_maps,
                        size_t idx,
                        const Eigen::Vector2d& keypoint,
                        CostMapMinimum* minimum);

// The scene with Frame::feature_keypoints from the cost maps of its frames.
// With F the feature at xy and f the reference, noise of F displaces the
// minimum with a covariance proportional to (|F - f|^2 + typical |F - f|^2) /
// sharpness: that is the relative weight, and one number, the noise of a
// typical feature in pixels, remains to be estimated from residuals. Directions
// in which a feature is vague (an edge, no texture) get no weight.
Scene FindFeatureKeypoints(int num_threads, Scene scene);

}  // namespace mfir
