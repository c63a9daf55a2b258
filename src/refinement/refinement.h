// The solves with fixed extrinsics: from a first guess of intrinsics and points
// to the final result.

#pragma once

#include <vector>

#include <Eigen/Core>

#include "src/refinement/options.h"
#include "src/refinement/stage.h"
#include "src/residuals/scale_mixture_loss.h"
#include "src/scene/estimate.h"
#include "src/scene/scene.h"

namespace mfir {

struct RefinementResult {
  Estimate estimate;
  bool converged = false;
  // Ended before the iterations ran out, because no step led on.
  bool stalled = false;
  // See FixedExtrinsicsSummary.
  double last_step_stds = 0.0;
  double last_focal_change = 0.0;
  // See FixedExtrinsicsSummary; the tracks of a static point
  // (static_point_search.h) have common errors. In single-frame mode: of the
  // median over frames, taken for independent.
  Eigen::MatrixXd covariance;
  // Noise of the keypoints (px per axis) and share of outliers as estimated
  // from the residuals.
  double noise_std_px = 0.0;
  double outlier_share = 0.0;
  // The whole distribution of that noise; empty in single-frame mode, where
  // every frame has its own.
  std::vector<NoiseComponent> noise_components;
  // Noise of a typical dense feature (px per axis); 0: none took part.
  double feature_noise_std_px = 0.0;
  // See FixedExtrinsicsSummary.
  std::vector<bool> held_cameras;
};

// Minimizes the reprojection error over points and intrinsics with the
// extrinsics pinned to the known ones: one set of intrinsics per camera, or, in
// single-frame mode, one per camera and frame (then the rig's cameras get the
// median).
//
// With options.loss_scale > 0 the loss is Cauchy's and each frame has the
// weight 1 / number of its observations (eq. 2). With 0 the loss is a
// ScaleMixtureLoss, refitted to the residuals until its scale stays, and every
// observation has the same weight. `from_frames`: the points come straight from
// the frames' reconstructions, not from a schedule: approach in solves with a
// shrinking Cauchy scale first.
//
// Extrinsics stay as they are in `start`, or, with extrinsics_*_std (the
// translation in units of the scene), are corrected around those of the scene.
RefinementResult RefineFixedExtrinsics(const MultiFrameOptions& options,
                                       bool from_frames,
                                       const StageCallback& callback,
                                       const Scene& scene,
                                       Estimate start);

// Intersects the tracks with the intrinsics and extrinsics of the estimate,
// which stay as they are.
Estimate FitPoints(const MultiFrameOptions& options,
                   const Scene& scene,
                   Estimate estimate);

// Cauchy scale (px) that suits the noise of the frames' observations under
// their own poses and intrinsics.
double EstimateCauchyScale(const Scene& scene, const Estimate& estimate);

// Squared residual norms (px^2) as in fixed_extrinsics_solver.h, in
// single-frame mode with the intrinsics of the frames.
std::vector<double> SquaredResiduals(const Scene& scene,
                                     const Estimate& estimate,
                                     bool single_frame_mode);

}  // namespace mfir
