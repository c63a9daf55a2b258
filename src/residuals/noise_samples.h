// Residuals under the known extrinsics, and what they tell about the noise.

#pragma once

#include <cstddef>
#include <vector>

#include <ceres/loss_function.h>

#include "src/parallel/communicator.h"
#include "src/scene/estimate.h"
#include "src/scene/scene.h"

namespace mfir {

// Squared residual norm (px^2) of every observation under the extrinsics and
// intrinsics of the rig's cameras, in order of frames and observations;
// infinite for points behind the camera.
std::vector<double> SquaredResiduals(const Scene& scene,
                                     const Estimate& estimate,
                                     int num_threads = -1);

// One coordinate of a residual as a sample of the noise.
struct NoiseSample {
  double squared;  // px^2, corrected for the fit of the point
  double weight;   // degrees of freedom, 0 to 1
};

struct NoiseSampleSets {
  std::vector<NoiseSample> keypoints;
  // Of the whitened distances from the features' keypoints.
  std::vector<NoiseSample> features;
};

// Samples of the noise from the residuals of all observations. A residual is
// smaller than the noise because the point was fitted to it, all the more where
// few observations carry a track (of the four coordinates of two views only one
// is left). Its covariance is, in units of the noise,
//
//   C_i = I - w_i J_i V^-1 J_i^T,   V = sum_k w_k J_k^T J_k,
//
// with J the Jacobian of the point and w the weights of the robust fit: rho'(s)
// over the rho'(0) of keypoints (1 without a loss). Features count in V with W
// J and their own loss; without `feature_loss` the fit has not used them. Each
// eigenvector e of C_i with eigenvalue l gives the sample (e . r_i)^2 / l with
// weight l; directions that the fit has made zero, or in which a feature is
// vague, do not count.
NoiseSampleSets NoiseSamples(const Scene& scene,
                             const Estimate& estimate,
                             const ceres::LossFunction* loss,
                             const ceres::LossFunction* feature_loss,
                             int num_threads = -1);

// Standard deviation (px per axis) of Gaussian noise with the same weighted
// median of squares, those of all ranks. Zero without samples.
double RobustStd(const std::vector<NoiseSample>& samples,
                 const Communicator& ranks = Alone(),
                 int num_threads = 1);

}  // namespace mfir
