#include "src/refinement/refinement.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <memory>
#include <utility>

#include <ceres/loss_function.h>

#include "src/estimators/fixed_extrinsics_solver.h"
#include "src/refinement/initial_intrinsics.h"
#include "src/residuals/noise_samples.h"
#include "src/residuals/scale_mixture_loss.h"
#include "src/scene/residual_statistics.h"
#include "src/selection/overlapping_tracks.h"
#include "src/selection/static_point_search.h"

namespace mfir {
namespace {

// Approach from the frames' reconstructions.
constexpr int kMaxNumStartSolves = 50;
// Standard deviations: what follows are a scale, in steps of 2 %, and a better
// loss.
constexpr double kStartStepTolerance = 0.03;
constexpr double kStartCostTolerance = 1e-3;
constexpr double kStepTolerance = 1e-4;
// Cauchy scale in units of the noise: 95 % efficient for Gaussian noise.
constexpr double kCauchyScaleInStds = 2.385;
constexpr double kScaleStep = 1.02;

constexpr double kTolerance = 1e-10;
// Distances of features have kinks where they vanish: steps among them are no
// smaller than this.
constexpr double kCostMapTolerance = 1e-6;

constexpr double kMinStd = 1e-6;  // px

// To a power of kScaleStep.
double RoundedStd(double std_px) {
  if (std_px == 0.0) return 0.0;
  return std::pow(kScaleStep,
                  std::round(std::log(std_px) / std::log(kScaleStep)));
}

// Losses of keypoints and, unless null, of features and cost maps.
struct Losses {
  const ceres::LossFunction* keypoints = nullptr;
  const ceres::LossFunction* features = nullptr;
  const ceres::LossFunction* cost_maps = nullptr;
  // Whether the cost is a negative log-likelihood.
  bool is_likelihood = false;
};

// Cauchy losses in px^2 of keypoints. feature_scale 0: without features.
class CauchyLosses {
 public:
  CauchyLosses(double scale, double feature_scale, double feature_weight)
      : keypoints_(scale) {
    if (feature_scale > 0.0) {
      features_ = std::make_unique<ceres::ScaledLoss>(
          new ceres::CauchyLoss(feature_scale),
          feature_weight,
          ceres::TAKE_OWNERSHIP);
    }
  }
  Losses Get() const { return {&keypoints_, features_.get(), nullptr, false}; }

 private:
  const ceres::CauchyLoss keypoints_;
  std::unique_ptr<const ceres::ScaledLoss> features_;
};

class Refiner {
 public:
  // Options, callback and scene must outlive this.
  Refiner(const MultiFrameOptions& options,
          const StageCallback& callback,
          const Scene& scene,
          Estimate start)
      : options_(options),
        callback_(callback),
        scene_(scene),
        ranks_(*scene.ranks),
        estimate_(std::move(start)) {}

  RefinementResult Run(bool from_frames) {
    std_px_ = Std(Samples({}).keypoints);
    if (from_frames || EstimatesLoss()) Approach("principal_points");
    // Features are looked for near keypoints, and need no better start.
    if (EstimatesLoss() && HasFeatures()) {
      feature_std_px_ = Std(Samples(MakeCauchyLosses().Get()).features);
      Approach("start");
    }
    // From a fit with a broad loss only: a sharp loss pulls points onto few of
    // their observations, and its residuals would sharpen it further.
    const CauchyLosses cauchy = MakeCauchyLosses();
    const NoiseSampleSets samples = Samples(cauchy.Get());
    const ScaleMixtureLoss noise(
        samples.keypoints, ranks_, options_.EffectiveNumThreads());
    const ScaleMixtureLoss feature_noise(
        samples.features, ranks_, options_.EffectiveNumThreads());
    const ceres::ScaledLoss feature_loss(&feature_noise,
                                         options_.featuremetric_weight,
                                         ceres::DO_NOT_TAKE_OWNERSHIP);
    Losses losses = cauchy.Get();
    // With a given loss the term is the paper's (eq. 5).
    const ceres::ScaledLoss cost_map_loss(
        losses.keypoints,
        options_.featuremetric_weight / options_.reprojection_weight,
        ceres::DO_NOT_TAKE_OWNERSHIP);
    if (!EstimatesLoss()) {
      if (HasCostMaps()) losses.cost_maps = &cost_map_loss;
    } else {
      losses.keypoints = &noise;
      losses.features = feature_std_px_ > 0.0 ? &feature_loss : nullptr;
      losses.is_likelihood = true;
    }
    const FixedExtrinsicsSummary summary =
        Solve("final",
              losses,
              kStepTolerance,
              losses.cost_maps == nullptr ? kTolerance : kCostMapTolerance);
    RefinementResult result;
    result.converged = summary.converged;
    result.stalled = Stalled(summary);
    result.last_step_stds = summary.last_step_stds;
    result.last_focal_change = summary.last_focal_change;
    result.covariance = summary.covariance;
    result.held_cameras = summary.held_cameras;
    const ScaleMixtureLoss reported_noise =
        EstimatesLoss() ? noise
                        : ScaleMixtureLoss(Samples(cauchy.Get()).keypoints,
                                           ranks_,
                                           options_.EffectiveNumThreads());
    result.noise_std_px = reported_noise.InlierStd();
    result.outlier_share = reported_noise.OutlierShare();
    result.noise_components = reported_noise.Components();
    if (feature_std_px_ > 0.0) {
      result.feature_noise_std_px = feature_noise.InlierStd();
    }
    result.estimate = std::move(estimate_);
    return result;
  }

 private:
  // Whether the losses follow from the residuals.
  bool EstimatesLoss() const { return options_.loss_scale == 0.0; }

  bool Stalled(const FixedExtrinsicsSummary& summary) const {
    return !summary.converged &&
           summary.num_iterations < options_.max_num_iterations;
  }

  bool HasFeatures() const {
    return options_.featuremetric_weight > 0.0 &&
           std::any_of(scene_.frames.begin(),
                       scene_.frames.end(),
                       [](const Frame& frame) {
                         return !frame.feature_keypoints.empty();
                       });
  }

  bool HasCostMaps() const {
    return options_.featuremetric_weight > 0.0 &&
           std::any_of(
               scene_.frames.begin(),
               scene_.frames.end(),
               [](const Frame& frame) { return frame.cost_maps != nullptr; });
  }

  CauchyLosses MakeCauchyLosses() const {
    if (!EstimatesLoss()) return CauchyLosses(options_.loss_scale, 0.0, 0.0);
    const double relative_std =
        feature_std_px_ > 0.0 ? std_px_ / feature_std_px_ : 0.0;
    return CauchyLosses(
        kCauchyScaleInStds * std_px_,
        kCauchyScaleInStds * feature_std_px_,
        options_.featuremetric_weight * relative_std * relative_std);
  }

  FixedExtrinsicsSummary Solve(const std::string& name,
                               const Losses& losses,
                               double step_tolerance,
                               double parameter_tolerance) {
    const auto start = std::chrono::steady_clock::now();
    FixedExtrinsicsOptions solver_options;
    // Principal points make up for most of what the poses of the frames made up
    // for; focal lengths that follow too early can run away.
    const bool only_principal_points =
        name == "principal_points" && options_.refine_principal_point;
    solver_options.refine_focal_length =
        options_.refine_focal_length && !only_principal_points;
    solver_options.refine_principal_point = options_.refine_principal_point;
    solver_options.refine_extra_params =
        options_.refine_extra_params && !only_principal_points;
    solver_options.loss = losses.keypoints;
    solver_options.feature_loss = losses.features;
    solver_options.cost_map_loss = losses.cost_maps;
    // The minima of a fixed, sharp loss are those the schedule leads to.
    solver_options.improve_points = EstimatesLoss();
    solver_options.max_num_iterations = options_.max_num_iterations;
    solver_options.step_tolerance = step_tolerance;
    solver_options.parameter_tolerance = parameter_tolerance;
    if (name != "final") {
      solver_options.cost_tolerance = kStartCostTolerance;
    } else {
      solver_options.compute_covariance = true;
      solver_options.repeated_tracks =
          FindOverRanks(scene_, [this](const Scene& all) {
            const int num_threads = options_.EffectiveNumThreads();
            return GroupOverlappingTracks(
                all, FindStaticPoints(all, num_threads), num_threads);
          });
    }
    solver_options.num_threads = options_.EffectiveNumThreads();
    for (const RigCamera& camera : scene_.cameras) {
      solver_options.constant_cameras.push_back(camera.constant_intrinsics);
    }
    solver_options.rotation_std =
        options_.extrinsics_rotation_std_deg * M_PI / 180.0;
    solver_options.center_std = options_.extrinsics_translation_std;
    solver_options.focal_std = options_.prior_focal_std;
    solver_options.principal_point_std = options_.prior_principal_point_std;
    // Far from the solution little information only means a bad fit.
    if (name == "final") {
      solver_options.min_information = options_.min_information;
    }
    solver_options.weak_distortion_prior = options_.min_information != 0.0;
    const size_t num_frames = Sum(ranks_, scene_.frames.size());
    double weight_sum = 0.0;
    double num_observations = 0.0;
    for (const Frame& frame : scene_.frames) {
      // Estimated noise is that of every observation, whatever its frame.
      const double divisor =
          EstimatesLoss() ? 1.0
                          : static_cast<double>(
                                num_frames *
                                std::max<size_t>(frame.observations.size(), 1));
      const double weight = options_.reprojection_weight / divisor;
      solver_options.frame_weights.push_back(weight);
      weight_sum += weight * static_cast<double>(frame.observations.size());
      num_observations += static_cast<double>(frame.observations.size());
    }
    // What a squared residual of one standard deviation weighs in the cost.
    solver_options.prior_weight =
        Sum(ranks_, weight_sum) / std::max(Sum(ranks_, num_observations), 1.0) *
        (losses.is_likelihood ? 1.0 : std_px_ * std_px_);
    FixedExtrinsicsSummary summary =
        SolveFixedExtrinsics(solver_options, scene_, std::move(estimate_));
    estimate_ = std::move(summary.estimate);

    Stage stage;
    stage.name = name;
    stage.weights = {{"reprojection", options_.reprojection_weight}};
    stage.costs = {
        {"reprojection", summary.final_cost - summary.final_feature_cost}};
    if (losses.features != nullptr || losses.cost_maps != nullptr) {
      stage.weights.emplace_back("featuremetric",
                                 options_.featuremetric_weight);
      stage.costs.emplace_back("featuremetric", summary.final_feature_cost);
    }
    stage.num_iterations = summary.num_iterations;
    stage.time_s =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start)
            .count();
    stage.termination = summary.converged  ? "converged"
                        : Stalled(summary) ? "failed"
                                           : "max_num_iterations";
    stage.rms_px = InlierRms(
        SquaredResiduals(scene_, estimate_, options_.EffectiveNumThreads()),
        ranks_,
        options_.EffectiveNumThreads());
    callback_(stage);
    return summary;
  }

  // Solves with Cauchy losses of scales that follow the residuals, until they
  // no longer fall. Scales are rounded, so that the last ones do not depend on
  // the way there.
  void Approach(const std::string& first_name) {
    std_px_ = RoundedStd(std_px_);
    feature_std_px_ = RoundedStd(feature_std_px_);
    bool fell = false;
    for (int i = 0; i < kMaxNumStartSolves; ++i) {
      const CauchyLosses losses = MakeCauchyLosses();
      const std::string name = i == 0 ? first_name : "start";
      Solve(name, losses.Get(), kStartStepTolerance, kTolerance);
      const NoiseSampleSets samples = Samples(losses.Get());
      const double std_px = RoundedStd(Std(samples.keypoints));
      const double feature_std_px =
          feature_std_px_ > 0.0 ? RoundedStd(Std(samples.features)) : 0.0;
      const bool falls = std_px < std_px_ || feature_std_px < feature_std_px_;
      const bool stays = std_px == std_px_ && feature_std_px == feature_std_px_;
      // Of the principal points alone nothing follows about the scale.
      if (name == "start" && (stays || (fell && !falls))) break;
      fell = fell || falls;
      std_px_ = std_px;
      feature_std_px_ = feature_std_px;
    }
  }

  double Std(const std::vector<NoiseSample>& samples) const {
    return RobustStd(samples, ranks_, options_.EffectiveNumThreads());
  }

  NoiseSampleSets Samples(const Losses& losses) const {
    NoiseSampleSets sets = NoiseSamples(scene_,
                                        estimate_,
                                        losses.keypoints,
                                        losses.features,
                                        options_.EffectiveNumThreads());
    for (auto* samples : {&sets.keypoints, &sets.features}) {
      for (NoiseSample& sample : *samples) {
        // Noise-free data has residuals of rounding size, or none at all.
        sample.squared = std::max(sample.squared, kMinStd * kMinStd);
      }
      if (Sum(ranks_, samples->size()) == 0) samples->push_back({1.0, 1.0});
    }
    return sets;
  }

  const MultiFrameOptions& options_;
  const StageCallback& callback_;
  const Scene& scene_;
  const Communicator& ranks_;
  Estimate estimate_;
  double std_px_ = 0.0;
  // Of a typical feature; 0: features take no part (yet).
  double feature_std_px_ = 0.0;
};

// The frame as a scene of its own, its images' intrinsics those of the rig.
SceneEstimate SingleFrame(const Scene& scene,
                          const Estimate& estimate,
                          size_t frame_idx) {
  SceneEstimate single;
  single.scene.cameras = scene.cameras;
  single.scene.frames = {scene.frames[frame_idx]};
  single.estimate.cameras = FrameCameras(scene, estimate, frame_idx);
  single.estimate.frames = {estimate.frames[frame_idx]};
  return single;
}

bool HasIntrinsicsPrior(const MultiFrameOptions& options) {
  return options.prior_focal_std > 0.0 ||
         options.prior_principal_point_std > 0.0;
}

// Adds what the solve of one of `num_frames` frames has found.
void AddFrameResult(const RefinementResult& frame,
                    double num_frames,
                    RefinementResult* sum) {
  sum->converged = sum->converged && frame.converged;
  sum->stalled = sum->stalled || frame.stalled;
  sum->last_step_stds = std::max(sum->last_step_stds, frame.last_step_stds);
  sum->last_focal_change =
      std::max(sum->last_focal_change, frame.last_focal_change);
  for (size_t c = 0; c < sum->held_cameras.size(); ++c) {
    sum->held_cameras[c] = sum->held_cameras[c] || frame.held_cameras[c];
  }
  sum->noise_std_px += frame.noise_std_px / num_frames;
  sum->outlier_share += frame.outlier_share / num_frames;
  sum->feature_noise_std_px += frame.feature_noise_std_px / num_frames;
  if (sum->covariance.size() == 0) {
    sum->covariance.setZero(frame.covariance.rows(), frame.covariance.cols());
  }
  sum->covariance += frame.covariance;
}

// By intrinsic parameter: 1 / number of images of its camera.
Eigen::VectorXd InverseImageCounts(const Scene& scene) {
  std::vector<double> inverse_counts;
  for (size_t c = 0; c < scene.cameras.size(); ++c) {
    double count = 0.0;
    for (const Frame& frame : scene.frames) {
      for (const FrameImage& image : frame.images) {
        count += image.camera_idx == c;
      }
    }
    inverse_counts.resize(
        inverse_counts.size() + scene.cameras[c].params.size(),
        1.0 / std::max(count, 1.0));
  }
  return Eigen::Map<Eigen::VectorXd>(inverse_counts.data(),
                                     inverse_counts.size());
}

// Every frame on its own.
RefinementResult RefineSingleFrames(const MultiFrameOptions& options,
                                    bool from_frames,
                                    const StageCallback& callback,
                                    const Scene& scene,
                                    Estimate start) {
  RefinementResult result;
  result.converged = true;
  result.held_cameras.assign(scene.cameras.size(), false);
  result.estimate = std::move(start);
  for (size_t i = 0; i < scene.frames.size(); ++i) {
    SceneEstimate single = SingleFrame(scene, result.estimate, i);
    if (from_frames && !HasIntrinsicsPrior(options)) {
      // What is held stays at the start of the frame, whatever the others are.
      for (size_t c = 0; c < scene.cameras.size(); ++c) {
        single.scene.cameras[c].params = single.estimate.cameras[c].params;
      }
    }
    RefinementResult frame_result =
        Refiner(options, callback, single.scene, std::move(single.estimate))
            .Run(from_frames);
    const Estimate& refined = frame_result.estimate;
    FrameEstimate& frame = result.estimate.frames[i];
    frame.points = refined.frames[0].points;
    for (size_t j = 0; j < frame.images.size(); ++j) {
      frame.images[j].params =
          refined.cameras[scene.frames[i].images[j].camera_idx].params;
    }
    AddFrameResult(
        frame_result, static_cast<double>(scene.frames.size()), &result);
  }
  // Of the mean over the independent frames that have the camera; the median is
  // about as good.
  const Eigen::VectorXd inverse_counts = InverseImageCounts(scene);
  result.covariance = inverse_counts.asDiagonal() * result.covariance *
                      inverse_counts.asDiagonal();
  result.estimate.cameras = WithMedianIntrinsics(
      scene, result.estimate.frames, std::move(result.estimate.cameras));
  return result;
}

}  // namespace

RefinementResult RefineFixedExtrinsics(const MultiFrameOptions& options,
                                       bool from_frames,
                                       const StageCallback& callback,
                                       const Scene& scene,
                                       Estimate start) {
  if (options.SingleFrameMode()) {
    return RefineSingleFrames(
        options, from_frames, callback, scene, std::move(start));
  }
  return Refiner(options, callback, scene, std::move(start)).Run(from_frames);
}

Estimate FitPoints(const MultiFrameOptions& options,
                   const Scene& scene,
                   Estimate estimate) {
  MultiFrameOptions points_only = options;
  points_only.refine_focal_length = false;
  points_only.refine_principal_point = false;
  points_only.refine_extra_params = false;
  points_only.extrinsics_rotation_std_deg = 0.0;
  points_only.extrinsics_translation_std = 0.0;
  return RefineFixedExtrinsics(
             points_only, true, [](const Stage&) {}, scene, std::move(estimate))
      .estimate;
}

double EstimateCauchyScale(const Scene& scene, const Estimate& estimate) {
  std::vector<NoiseSample> samples;
  for (size_t i = 0; i < scene.frames.size(); ++i) {
    SceneEstimate single = SingleFrame(scene, estimate, i);
    const std::vector<FrameImage>& images = scene.frames[i].images;
    for (size_t j = 0; j < images.size(); ++j) {
      single.estimate.cameras[images[j].camera_idx].cam_from_world =
          estimate.frames[i].images[j].cam_from_world;
    }
    const std::vector<NoiseSample> frame_samples =
        NoiseSamples(single.scene, single.estimate, nullptr, nullptr).keypoints;
    samples.insert(samples.end(), frame_samples.begin(), frame_samples.end());
  }
  return std::max(1e-3, kCauchyScaleInStds * RobustStd(samples));
}

std::vector<double> SquaredResiduals(const Scene& scene,
                                     const Estimate& estimate,
                                     bool single_frame_mode) {
  if (!single_frame_mode) return SquaredResiduals(scene, estimate);
  std::vector<double> squared_residuals;
  for (size_t i = 0; i < scene.frames.size(); ++i) {
    const SceneEstimate single = SingleFrame(scene, estimate, i);
    const std::vector<double> frame_residuals =
        SquaredResiduals(single.scene, single.estimate);
    squared_residuals.insert(squared_residuals.end(),
                             frame_residuals.begin(),
                             frame_residuals.end());
  }
  return squared_residuals;
}

}  // namespace mfir
