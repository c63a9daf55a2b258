// Bundle adjustment of shared intrinsics and points with all extrinsics fixed:
// the last solve of every run.

#pragma once

#include <ceres/loss_function.h>

#include <Eigen/Core>
#include <vector>

#include "scene.h"

namespace mfir {

struct FixedExtrinsicsOptions {
  bool refine_focal_length = true;
  bool refine_principal_point = true;
  bool refine_extra_params = true;

  // Robust loss of |r|, r in pixels. Must outlive the solve.
  const ceres::LossFunction* loss = nullptr;

  // Weight of each frame's observations; empty: 1.
  std::vector<double> frame_weights;

  int max_num_iterations = 100;

  // Converged when an undamped step changes no focal length by more than this
  // (relative), no principal point by more than this times the focal length,
  // and no distortion by more than that at the image corner.
  double parameter_tolerance = 1e-10;

  // Whether to compute the covariance at the solution.
  bool compute_covariance = false;

  int num_threads = 1;
};

struct FixedExtrinsicsSummary {
  double initial_cost = 0.0;
  double final_cost = 0.0;
  int num_iterations = 0;
  bool converged = false;
  // Largest change of a focal length in the last step, relative.
  double last_focal_change = 0.0;
  // Covariance of the refined parameters, stacked by camera; held parameters
  // have zero rows, undetermined ones NaN. It is the sandwich H^-1 G H^-1 with
  // H the reduced Hessian and G the sum over tracks of the outer products of
  // their gradients: honest whatever the noise is, as long as tracks are
  // independent.
  Eigen::MatrixXd covariance;
};

// Minimizes, over the intrinsics of scene->cameras and all points,
//
//   sum_frames weight_f sum_obs 1/2 rho(|Project(params_c, R_c X + t_c) -
//   xy|^2)
//
// with R_c, t_c the known extrinsics (poses of the frames' images are not
// used). Newton steps with the second derivative of the loss, points eliminated
// one by one: time and memory grow linearly with the number of points, only the
// reduced system of the intrinsics is dense. Observations behind their camera
// at the start of the solve take no part in it. The result is the same for
// every number of threads.
FixedExtrinsicsSummary SolveFixedExtrinsics(
    const FixedExtrinsicsOptions& options, Scene* scene);

// Squared residual norm (px^2) of every observation under the known extrinsics
// and the intrinsics of the rig, in order of frames and observations; infinite
// for points behind the camera.
std::vector<double> SquaredResiduals(const Scene& scene);

// One coordinate of a residual as a sample of the noise.
struct NoiseSample {
  double squared;  // px^2, corrected for the fit of the point
  double weight;   // degrees of freedom, 0 to 1
};

// Samples of the noise from the residuals of all observations. A residual is
// smaller than the noise because the point was fitted to it, all the more where
// few observations carry a track (of the four coordinates of two views only one
// is left). Its covariance is, in units of the noise,
//
//   C_i = I - w_i J_i V^-1 J_i^T,   V = sum_k w_k J_k^T J_k,
//
// with J the Jacobian of the point and w = rho'(s) / rho'(0) the weights of the
// robust fit (1 without a loss). Each eigenvector e of C_i with eigenvalue l
// gives the sample (e . r_i)^2 / l with weight l; directions that the fit has
// made zero do not count.
std::vector<NoiseSample> NoiseSamples(const Scene& scene,
                                      const ceres::LossFunction* loss);

// Standard deviation (px per axis) of Gaussian noise with the same weighted
// median of squares. Zero without samples.
double RobustStd(std::vector<NoiseSample> samples);

}  // namespace mfir
