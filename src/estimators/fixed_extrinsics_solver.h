// Bundle adjustment of what all frames share (the intrinsics) and of all
// points, with the extrinsics known: the last solve of every run.

#pragma once

#include <cstddef>
#include <vector>

#include <ceres/loss_function.h>
#include <Eigen/Core>

#include "src/scene/estimate.h"
#include "src/scene/scene.h"

namespace mfir {

struct FixedExtrinsicsOptions {
  bool refine_focal_length = true;
  bool refine_principal_point = true;
  bool refine_extra_params = true;
  // By camera: hold its intrinsics. Empty: none.
  std::vector<bool> constant_cameras;

  // Robust loss of |r|, r in pixels. Must outlive the solve.
  const ceres::LossFunction* loss = nullptr;
  // The same for dense features: of |W r_f|, see TrackSolver. Null: they take
  // no part.
  const ceres::LossFunction* feature_loss = nullptr;
  // Of |G|, the featuremetric residual; null: cost maps take no part.
  const ceres::LossFunction* cost_map_loss = nullptr;
  // Whether points with outliers among their observations also try the minima
  // around the intersections of their rays, so that the result depends neither
  // on where they start nor on the path.
  bool improve_points = true;
  // Weight of each frame's observations; empty: 1.
  std::vector<double> frame_weights;

  // Priors with these standard deviations, none where 0: rotation (rad per
  // axis) and camera centre (world units per axis), which are corrected only
  // then, and focal lengths and principal points (px), all around those of
  // Scene::cameras.
  double rotation_std = 0.0;
  double center_std = 0.0;
  double focal_std = 0.0;
  double principal_point_std = 0.0;
  // What a squared residual of one standard deviation weighs in the priors:
  // 1 where cost is a negative log-likelihood.
  double prior_weight = 1.0;

  // Combinations of intrinsics that the data determine worse than this are held
  // at Scene::cameras, unless they contradict it. Positive: less information
  // (1/px^2; intrinsics in pixels, distortion by what it moves the image
  // corner). Negative: a standard deviation of more than 2 % of the focal
  // length; for the others, of what moves the image corner by 2 % of half the
  // image diagonal. 0: none.
  double min_information = 0.0;
  // Whether distortion has a weak prior around Scene::cameras: a standard
  // deviation of what moves the image corner by 5 % of half the image diagonal.
  // Next to data that tell anything it is nothing, but rich lens models do not
  // run away in the first solves, and parameters without effect (the angle of
  // FOV at 0) do not make the equations singular.
  bool weak_distortion_prior = false;

  int max_num_iterations = 100;

  // Converged when an undamped step moves no intrinsic parameter, and no
  // combination of them, by more than this share of its standard deviation ...
  double step_tolerance = 1e-4;
  // ... or, where that is less, no focal length by more than this (relative),
  // no principal point by more than this times the focal length, and no
  // distortion by more than that at the image corner.
  double parameter_tolerance = 1e-10;
  // ... or when 50 iterations together have lowered the cost by no more than
  // this share: for a solve that others follow. 0: not for that.
  double cost_tolerance = 0.0;

  // Whether to compute the covariance at the solution.
  bool compute_covariance = false;
  // Groups of tracks with common errors, as of a static point in several
  // frames: each is one piece of evidence for the covariance. The others are
  // independent.
  std::vector<std::vector<TrackIndex>> repeated_tracks;

  int num_threads = 1;
};

struct FixedExtrinsicsSummary {
  Estimate estimate;
  double initial_cost = 0.0;
  double final_cost = 0.0;
  double final_feature_cost = 0.0;  // part of final_cost
  int num_iterations = 0;
  bool converged = false;
  // The last undamped step: the most by which it moves a parameter or a
  // combination of parameters, in standard deviations, and a focal length,
  // relative.
  double last_step_stds = 0.0;
  double last_focal_change = 0.0;
  // Tracks whose point has no minimum: they take no part.
  size_t num_tracks_left_out = 0;
  // Covariance of the intrinsics, stacked by camera; parameters that are not
  // refined have zero rows, combinations held by min_information the variance
  // that it stands for; all is NaN if the normal equations are singular.
  // It is the sandwich H^-1 G H^-1 with H the reduced Hessian and G the sum of
  // the outer products of the gradients of tracks, which are added up before in
  // each group of repeated_tracks: honest whatever the noise is, as long as
  // groups and other tracks are independent.
  Eigen::MatrixXd covariance;
  // By camera: whether its intrinsics take part in a combination that
  // min_information holds.
  std::vector<bool> held_cameras;
};

// Minimizes, over the intrinsics of the estimate's cameras and all points,
//
//   sum_frames weight_f sum_obs
//       1/2 rho(|Project(params_c, R_c X + t_c) - xy|^2)
//   + prior_weight sum_priors 1/2 ((parameter - known) / std)^2
//
// with R_c, t_c the extrinsics of the estimate's cameras (poses of the frames'
// images are not used), which stay or are corrected under a prior. Newton steps
// with the second derivative of the loss, points eliminated one by one and
// moved to their minima after each step: time and memory grow linearly with the
// number of points, only the reduced system of the cameras is dense.
// Observations behind their camera at the start of the solve take no part in
// it. The result is the same for every number of threads. Over ranks, points
// stay where they are: what is summed are the equations of the cameras, costs
// and counts.
FixedExtrinsicsSummary SolveFixedExtrinsics(
    const FixedExtrinsicsOptions& options, const Scene& scene, Estimate start);

}  // namespace mfir
