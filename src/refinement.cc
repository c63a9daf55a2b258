#include "refinement.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <memory>
#include <set>

#include <ceres/loss_function.h>

#include "fixed_extrinsics_solver.h"
#include "scale_mixture_loss.h"

namespace mfir {
namespace {

// Approach from the frames' reconstructions.
constexpr int kMaxNumStartSolves = 20;
constexpr int kMaxNumStartIterations = 10;
constexpr double kStartTolerance = 1e-5;
// Cauchy scale in units of the noise: 95 % efficient for Gaussian noise.
constexpr double kCauchyScaleInStds = 2.385;
constexpr double kMinScaleReduction = 0.02;

constexpr int kMaxNumNoiseSolves = 20;
constexpr double kNoiseTolerance = 1e-7;
constexpr double kNoiseStdTolerance = 1e-3;

double Median(std::vector<double> values) {
  const auto middle = values.begin() + values.size() / 2;
  std::nth_element(values.begin(), middle, values.end());
  if (values.size() % 2 == 1) return *middle;
  return 0.5 * (*middle + *std::max_element(values.begin(), middle));
}

// Standard deviation (px per axis) of Gaussian noise with the same median of
// squared norms, 2 ln(2) sigma^2.
double RobustStd(const std::vector<double>& samples) {
  return samples.empty() ? 0.0
                         : std::sqrt(Median(samples) / (2.0 * std::log(2.0)));
}

class Refiner {
 public:
  Refiner(const MultiFrameOptions& options,
          const StageCallback& callback,
          Scene* scene)
      : options_(options), callback_(callback), scene_(scene) {}

  RefinementResult Run(bool from_frames) {
    if (from_frames) Approach();
    RefinementResult result;
    std::unique_ptr<ceres::LossFunction> loss;
    if (options_.loss_scale > 0.0) {
      loss = std::make_unique<ceres::CauchyLoss>(options_.loss_scale);
    } else {
      loss = EstimateNoise();
    }
    const FixedExtrinsicsSummary summary =
        Solve("final", *loss, options_.max_num_iterations, 1e-10, true);
    result.converged = summary.converged;
    result.last_focal_change = summary.last_focal_change;
    result.covariance = summary.covariance;
    const std::vector<double> samples = Samples();
    if (!samples.empty()) {
      const ScaleMixtureLoss noise(samples);
      result.noise_std_px = noise.CoreStd();
      result.outlier_share = noise.OutlierShare();
    }
    return result;
  }

 private:
  std::vector<double> Samples() const {
    return NoiseSamples(*scene_, SquaredResiduals(*scene_));
  }

  FixedExtrinsicsSummary Solve(const std::string& name,
                               const ceres::LossFunction& loss,
                               int max_num_iterations,
                               double tolerance,
                               bool final_solve) {
    const auto start = std::chrono::steady_clock::now();
    FixedExtrinsicsOptions solver_options;
    solver_options.refine_focal_length = options_.refine_focal_length;
    solver_options.refine_principal_point = options_.refine_principal_point;
    solver_options.refine_extra_params = options_.refine_extra_params;
    solver_options.loss = &loss;
    solver_options.max_num_iterations = max_num_iterations;
    solver_options.parameter_tolerance = tolerance;
    solver_options.compute_covariance = final_solve;
    solver_options.num_threads = options_.EffectiveNumThreads();
    if (options_.loss_scale > 0.0) {
      for (const Frame& frame : scene_->frames) {
        solver_options.frame_weights.push_back(
            options_.reprojection_weight /
            static_cast<double>(scene_->frames.size() *
                                frame.observations.size()));
      }
    }
    const FixedExtrinsicsSummary summary =
        SolveFixedExtrinsics(solver_options, scene_);

    Stage stage;
    stage.name = name;
    stage.weights = {{"reprojection", options_.reprojection_weight}};
    stage.costs = {{"reprojection", summary.final_cost}};
    stage.num_iterations = summary.num_iterations;
    stage.time_s =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start)
            .count();
    stage.termination = summary.converged ? "converged" : "max_num_iterations";
    stage.rms_px = ReprojectionRms(*scene_, false).back();
    callback_(stage);
    return summary;
  }

  // Solves with Cauchy losses of a scale that follows the residuals down.
  void Approach() {
    double std_px = RobustStd(Samples());
    for (int i = 0; i < kMaxNumStartSolves && std_px > 0.0; ++i) {
      const ceres::CauchyLoss loss(kCauchyScaleInStds * std_px);
      Solve("start", loss, kMaxNumStartIterations, kStartTolerance, false);
      const double new_std_px = RobustStd(Samples());
      const bool settled = new_std_px > (1.0 - kMinScaleReduction) * std_px;
      std_px = new_std_px;
      if (settled) break;
    }
  }

  std::unique_ptr<ceres::LossFunction> EstimateNoise() {
    double previous_std = 0.0;
    for (int i = 0;; ++i) {
      std::vector<double> samples = Samples();
      if (samples.empty()) samples.push_back(1.0);
      auto loss = std::make_unique<ScaleMixtureLoss>(samples);
      const double change = std::abs(loss->CoreStd() / previous_std - 1.0);
      previous_std = loss->CoreStd();
      if (i == kMaxNumNoiseSolves || (i > 0 && change < kNoiseStdTolerance)) {
        return loss;
      }
      Solve("noise", *loss, kMaxNumStartIterations, kNoiseTolerance, false);
    }
  }

  const MultiFrameOptions& options_;
  const StageCallback& callback_;
  Scene* scene_;
};

// The frame as a scene of its own, its images' intrinsics those of the rig.
Scene SingleFrameScene(const Scene& scene, size_t frame_idx) {
  Scene single;
  single.cameras = scene.cameras;
  single.frames = {scene.frames[frame_idx]};
  for (const FrameImage& image : single.frames[0].images) {
    single.cameras[image.camera_idx].params = image.params;
  }
  return single;
}

void SetMedianIntrinsics(Scene* scene) {
  for (size_t i = 0; i < scene->cameras.size(); ++i) {
    RigCamera& camera = scene->cameras[i];
    if (camera.model == nullptr) continue;
    camera.params.resize(camera.model->NumParams());
    for (size_t j = 0; j < camera.params.size(); ++j) {
      std::vector<double> values;
      for (const Frame& frame : scene->frames) {
        for (const FrameImage& image : frame.images) {
          if (image.camera_idx == i) values.push_back(image.params[j]);
        }
      }
      if (!values.empty()) camera.params[j] = Median(values);
    }
  }
}

}  // namespace

void InitializeIntrinsics(const MultiFrameOptions& options, Scene* scene) {
  SetMedianIntrinsics(scene);
  for (Frame& frame : scene->frames) {
    for (FrameImage& image : frame.images) {
      const RigCamera& camera = scene->cameras[image.camera_idx];
      const auto hold = [&](bool refine, const std::vector<size_t>& idxs) {
        for (const size_t idx : idxs) {
          if (!refine) image.params[idx] = camera.params[idx];
        }
      };
      hold(options.refine_focal_length, camera.model->FocalLengthIdxs());
      hold(options.refine_principal_point, camera.model->PrincipalPointIdxs());
      hold(options.refine_extra_params, camera.model->ExtraParamsIdxs());
    }
  }
}

RefinementResult RefineFixedExtrinsics(const MultiFrameOptions& options,
                                       bool from_frames,
                                       const StageCallback& callback,
                                       Scene* scene) {
  if (!options.SingleFrameMode()) {
    return Refiner(options, callback, scene).Run(from_frames);
  }
  RefinementResult result;
  result.converged = true;
  for (size_t i = 0; i < scene->frames.size(); ++i) {
    Scene single = SingleFrameScene(*scene, i);
    const RefinementResult frame_result =
        Refiner(options, callback, &single).Run(from_frames);
    scene->frames[i] = std::move(single.frames[0]);
    for (FrameImage& image : scene->frames[i].images) {
      image.params = single.cameras[image.camera_idx].params;
    }
    const double num_frames = static_cast<double>(scene->frames.size());
    result.converged = result.converged && frame_result.converged;
    result.last_focal_change =
        std::max(result.last_focal_change, frame_result.last_focal_change);
    result.noise_std_px += frame_result.noise_std_px / num_frames;
    result.outlier_share += frame_result.outlier_share / num_frames;
    // The mean of independent frames; the median is about as good.
    if (i == 0) {
      result.covariance = frame_result.covariance / (num_frames * num_frames);
    } else {
      result.covariance += frame_result.covariance / (num_frames * num_frames);
    }
  }
  SetMedianIntrinsics(scene);
  return result;
}

double EstimateCauchyScale(const Scene& scene) {
  std::vector<double> samples;
  for (size_t i = 0; i < scene.frames.size(); ++i) {
    Scene single = SingleFrameScene(scene, i);
    for (const FrameImage& image : single.frames[0].images) {
      single.cameras[image.camera_idx].cam_from_world = image.cam_from_world;
    }
    const std::vector<double> frame_samples =
        NoiseSamples(single, SquaredResiduals(single));
    samples.insert(samples.end(), frame_samples.begin(), frame_samples.end());
  }
  return samples.empty()
             ? 1.0
             : std::max(1e-3, kCauchyScaleInStds * RobustStd(samples));
}

std::vector<double> ReprojectionRms(const Scene& scene,
                                    bool single_frame_mode) {
  std::vector<double> sums(scene.cameras.size() + 1, 0.0);
  std::vector<double> counts(scene.cameras.size() + 1, 0.0);
  for (size_t i = 0; i < scene.frames.size(); ++i) {
    Scene single = SingleFrameScene(scene, i);
    if (!single_frame_mode) single.cameras = scene.cameras;
    const Frame& frame = single.frames[0];
    const std::vector<double> squared_residuals = SquaredResiduals(single);
    for (size_t k = 0; k < squared_residuals.size(); ++k) {
      if (!std::isfinite(squared_residuals[k])) continue;
      const size_t camera_idx =
          frame.images[frame.observations[k].image_idx].camera_idx;
      for (const size_t idx : {camera_idx, scene.cameras.size()}) {
        sums[idx] += squared_residuals[k];
        counts[idx] += 1.0;
      }
    }
  }
  for (size_t i = 0; i < sums.size(); ++i) {
    sums[i] = counts[i] > 0.0 ? std::sqrt(sums[i] / counts[i])
                              : std::numeric_limits<double>::quiet_NaN();
  }
  return sums;
}

}  // namespace mfir
