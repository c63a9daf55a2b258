#include "src/refinement/refinement.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <memory>

#include <ceres/loss_function.h>

#include "src/estimators/fixed_extrinsics_solver.h"
#include "src/estimators/scale_mixture_loss.h"
#include "src/scene/residual_statistics.h"
#include "src/scene/static_point_search.h"
#include "src/util/median.h"

namespace mfir {
namespace {

// Approach from the frames' reconstructions.
constexpr int kMaxNumStartSolves = 50;
// Standard deviations: what follows are a scale, in steps of 2 %, and a better
// loss.
constexpr double kStartStepTolerance = 0.03;
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
  Refiner(const MultiFrameOptions& options,
          const StageCallback& callback,
          Scene* scene)
      : options_(options), callback_(callback), scene_(scene) {}

  RefinementResult Run(bool from_frames) {
    std_px_ = RobustStd(Samples({}).keypoints);
    if (from_frames || EstimatesLoss()) Approach("principal_points");
    // Features are looked for near keypoints, and need no better start.
    if (EstimatesLoss() && HasFeatures()) {
      feature_std_px_ = RobustStd(Samples(MakeCauchyLosses().Get()).features);
      Approach("start");
    }
    // From a fit with a broad loss only: a sharp loss pulls points onto few of
    // their observations, and its residuals would sharpen it further.
    const CauchyLosses cauchy = MakeCauchyLosses();
    const NoiseSampleSets samples = Samples(cauchy.Get());
    const ScaleMixtureLoss noise(samples.keypoints);
    const ScaleMixtureLoss feature_noise(samples.features);
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
    result.last_step_stds = summary.last_step_stds;
    result.last_focal_change = summary.last_focal_change;
    result.covariance = summary.covariance;
    result.held_cameras = summary.held_cameras;
    const ScaleMixtureLoss reported_noise =
        EstimatesLoss() ? noise
                        : ScaleMixtureLoss(Samples(cauchy.Get()).keypoints);
    result.noise_std_px = reported_noise.InlierStd();
    result.outlier_share = reported_noise.OutlierShare();
    if (feature_std_px_ > 0.0) {
      result.feature_noise_std_px = feature_noise.InlierStd();
    }
    return result;
  }

 private:
  // Whether the losses follow from the residuals.
  bool EstimatesLoss() const { return options_.loss_scale == 0.0; }

  bool HasFeatures() const {
    return options_.featuremetric_weight > 0.0 &&
           std::any_of(scene_->frames.begin(),
                       scene_->frames.end(),
                       [](const Frame& frame) {
                         return !frame.feature_keypoints.empty();
                       });
  }

  bool HasCostMaps() const {
    return options_.featuremetric_weight > 0.0 &&
           std::any_of(
               scene_->frames.begin(),
               scene_->frames.end(),
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
    if (name == "final") {
      solver_options.compute_covariance = true;
      solver_options.repeated_tracks = FindStaticPoints(*scene_);
    }
    solver_options.num_threads = options_.EffectiveNumThreads();
    for (const RigCamera& camera : scene_->cameras) {
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
    double weight_sum = 0.0;
    double num_observations = 0.0;
    for (const Frame& frame : scene_->frames) {
      // Estimated noise is that of every observation, whatever its frame.
      const double divisor =
          EstimatesLoss() ? 1.0
                          : static_cast<double>(
                                scene_->frames.size() *
                                std::max<size_t>(frame.observations.size(), 1));
      const double weight = options_.reprojection_weight / divisor;
      solver_options.frame_weights.push_back(weight);
      weight_sum += weight * static_cast<double>(frame.observations.size());
      num_observations += static_cast<double>(frame.observations.size());
    }
    // What a squared residual of one standard deviation weighs in the cost.
    solver_options.prior_weight =
        weight_sum / std::max(num_observations, 1.0) *
        (losses.is_likelihood ? 1.0 : std_px_ * std_px_);
    const FixedExtrinsicsSummary summary =
        SolveFixedExtrinsics(solver_options, scene_);

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
    stage.termination = summary.converged ? "converged" : "max_num_iterations";
    stage.rms_px = InlierRms(SquaredResiduals(*scene_));
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
      const double std_px = RoundedStd(RobustStd(samples.keypoints));
      const double feature_std_px =
          feature_std_px_ > 0.0 ? RoundedStd(RobustStd(samples.features)) : 0.0;
      const bool falls = std_px < std_px_ || feature_std_px < feature_std_px_;
      const bool stays = std_px == std_px_ && feature_std_px == feature_std_px_;
      // Of the principal points alone nothing follows about the scale.
      if (name == "start" && (stays || (fell && !falls))) break;
      fell = fell || falls;
      std_px_ = std_px;
      feature_std_px_ = feature_std_px;
    }
  }

  NoiseSampleSets Samples(const Losses& losses) const {
    NoiseSampleSets sets = NoiseSamples(*scene_,
                                        losses.keypoints,
                                        losses.features,
                                        options_.EffectiveNumThreads());
    for (auto* samples : {&sets.keypoints, &sets.features}) {
      for (NoiseSample& sample : *samples) {
        // Noise-free data has residuals of rounding size, or none at all.
        sample.squared = std::max(sample.squared, kMinStd * kMinStd);
      }
      if (samples->empty()) samples->push_back({1.0, 1.0});
    }
    return sets;
  }

  const MultiFrameOptions& options_;
  const StageCallback& callback_;
  Scene* scene_;
  double std_px_ = 0.0;
  // Of a typical feature; 0: features take no part (yet).
  double feature_std_px_ = 0.0;
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

bool HasIntrinsicsPrior(const MultiFrameOptions& options) {
  return options.prior_focal_std > 0.0 ||
         options.prior_principal_point_std > 0.0;
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

// COLMAP's limits of what is no bogus camera. Structure from motion with few
// images of a camera ends anywhere.
bool IsPlausible(const RigCamera& camera, const std::vector<double>& params) {
  const double max_size =
      static_cast<double>(std::max(camera.width, camera.height));
  for (const size_t idx : camera.model->FocalLengthIdxs()) {
    const double ratio = params[idx] / max_size;
    if (!(ratio >= 0.1 && ratio <= 10.0)) return false;
  }
  const std::vector<size_t>& idxs = camera.model->PrincipalPointIdxs();
  return params[idxs[0]] >= 0.0 && params[idxs[0]] <= camera.width &&
         params[idxs[1]] >= 0.0 && params[idxs[1]] <= camera.height;
}

// Replaces the medians of cameras that have implausible intrinsics in some
// frames by those of the others; without any, focal lengths by the median of
// the array's cameras of the same model and image size, and principal points by
// the image centre.
void ReplaceImplausibleIntrinsics(Scene* scene) {
  Scene plausible;
  plausible.cameras = scene->cameras;
  for (const Frame& frame : scene->frames) {
    plausible.frames.emplace_back();
    for (const FrameImage& image : frame.images) {
      if (IsPlausible(scene->cameras[image.camera_idx], image.params)) {
        plausible.frames.back().images.push_back(image);
      }
    }
  }
  SetMedianIntrinsics(&plausible);
  scene->cameras = plausible.cameras;
  for (RigCamera& camera : scene->cameras) {
    if (camera.model == nullptr || IsPlausible(camera, camera.params)) continue;
    for (const size_t idx : camera.model->FocalLengthIdxs()) {
      std::vector<double> focal_lengths;
      for (const RigCamera& other : plausible.cameras) {
        if (other.model == camera.model && other.width == camera.width &&
            other.height == camera.height && IsPlausible(other, other.params)) {
          focal_lengths.push_back(other.params[idx]);
        }
      }
      if (!focal_lengths.empty()) camera.params[idx] = Median(focal_lengths);
    }
    const std::vector<size_t>& idxs = camera.model->PrincipalPointIdxs();
    camera.params[idxs[0]] = 0.5 * static_cast<double>(camera.width);
    camera.params[idxs[1]] = 0.5 * static_cast<double>(camera.height);
  }
}

}  // namespace

void InitializeIntrinsics(const MultiFrameOptions& options, Scene* scene) {
  SetMedianIntrinsics(scene);
  ReplaceImplausibleIntrinsics(scene);
  for (RigCamera& camera : scene->cameras) {
    camera.prior_params = camera.params;
  }
  for (Frame& frame : scene->frames) {
    for (FrameImage& image : frame.images) {
      const RigCamera& camera = scene->cameras[image.camera_idx];
      const auto hold = [&](bool refine, const std::vector<size_t>& idxs) {
        for (const size_t idx : idxs) {
          if (!refine) image.params[idx] = camera.params[idx];
        }
      };
      if (camera.constant_intrinsics) image.params = camera.params;
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
  result.held_cameras.assign(scene->cameras.size(), false);
  for (size_t i = 0; i < scene->frames.size(); ++i) {
    Scene single = SingleFrameScene(*scene, i);
    if (from_frames && !HasIntrinsicsPrior(options)) {
      // What is held stays at the start of the frame, whatever the others are.
      for (RigCamera& camera : single.cameras) {
        camera.prior_params = camera.params;
      }
    }
    const RefinementResult frame_result =
        Refiner(options, callback, &single).Run(from_frames);
    scene->frames[i] = std::move(single.frames[0]);
    for (FrameImage& image : scene->frames[i].images) {
      image.params = single.cameras[image.camera_idx].params;
    }
    const double num_frames = static_cast<double>(scene->frames.size());
    result.converged = result.converged && frame_result.converged;
    result.last_step_stds =
        std::max(result.last_step_stds, frame_result.last_step_stds);
    result.last_focal_change =
        std::max(result.last_focal_change, frame_result.last_focal_change);
    for (size_t c = 0; c < result.held_cameras.size(); ++c) {
      result.held_cameras[c] =
          result.held_cameras[c] || frame_result.held_cameras[c];
    }
    result.noise_std_px += frame_result.noise_std_px / num_frames;
    result.outlier_share += frame_result.outlier_share / num_frames;
    result.feature_noise_std_px +=
        frame_result.feature_noise_std_px / num_frames;
    if (i == 0)
      result.covariance.setZero(frame_result.covariance.rows(),
                                frame_result.covariance.cols());
    result.covariance += frame_result.covariance;
  }
  // Of the mean over the independent frames that have the camera; the median is
  // about as good.
  Eigen::VectorXd inverse_counts(result.covariance.rows());
  Eigen::Index k = 0;
  for (size_t c = 0; c < scene->cameras.size(); ++c) {
    double count = 0.0;
    for (const Frame& frame : scene->frames) {
      for (const FrameImage& image : frame.images) {
        count += image.camera_idx == c;
      }
    }
    for (size_t j = 0; j < scene->cameras[c].params.size(); ++j) {
      inverse_counts(k++) = 1.0 / std::max(count, 1.0);
    }
  }
  result.covariance = inverse_counts.asDiagonal() * result.covariance *
                      inverse_counts.asDiagonal();
  SetMedianIntrinsics(scene);
  return result;
}

double EstimateCauchyScale(const Scene& scene) {
  std::vector<NoiseSample> samples;
  for (size_t i = 0; i < scene.frames.size(); ++i) {
    Scene single = SingleFrameScene(scene, i);
    for (const FrameImage& image : single.frames[0].images) {
      single.cameras[image.camera_idx].cam_from_world = image.cam_from_world;
    }
    const std::vector<NoiseSample> frame_samples =
        NoiseSamples(single, nullptr, nullptr).keypoints;
    samples.insert(samples.end(), frame_samples.begin(), frame_samples.end());
  }
  return std::max(1e-3, kCauchyScaleInStds * RobustStd(std::move(samples)));
}

std::vector<double> SquaredResiduals(const Scene& scene,
                                     bool single_frame_mode) {
  if (!single_frame_mode) return SquaredResiduals(scene);
  std::vector<double> squared_residuals;
  for (size_t i = 0; i < scene.frames.size(); ++i) {
    const std::vector<double> frame_residuals =
        SquaredResiduals(SingleFrameScene(scene, i));
    squared_residuals.insert(squared_residuals.end(),
                             frame_residuals.begin(),
                             frame_residuals.end());
  }
  return squared_residuals;
}

}  // namespace mfir
