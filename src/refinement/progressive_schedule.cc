#include "src/refinement/progressive_schedule.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <memory>

#include <ceres/manifold.h>

#include "src/estimators/free_params.h"
#include "src/refinement/priors.h"
#include "src/refinement/refinement.h"
#include "src/residuals/featuremetric_residual.h"
#include "src/scene/residual_statistics.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

constexpr double kFunctionTolerance = 1e-6;
// Threads of Ceres add in the order in which they finish: with more than one,
// no two runs would give the same bytes.
constexpr int kNumThreads = 1;

}  // namespace

ProgressiveSchedule::ProgressiveSchedule(const MultiFrameOptions& options,
                                         size_t num_frames,
                                         std::vector<RigCamera>* cameras,
                                         ceres::Problem* problem)
    : options_(options),
      num_frames_(static_cast<double>(num_frames)),
      cameras_(cameras),
      problem_(problem),
      terms_({{"reprojection", options.reprojection_weight, false, {}, {}},
              {"rotation_prior", options.rotation_prior_weight, true, {}, {}},
              {"translation_prior",
               options.translation_prior_weight,
               true,
               {},
               {}},
              {"focal_variance", options.focal_variance_weight, true, {}, {}},
              {"principal_point_variance",
               options.principal_point_variance_weight,
               true,
               {},
               {}},
              {"extra_params_variance",
               options.extra_params_variance_weight,
               true,
               {},
               {}},
              {"featuremetric", options.featuremetric_weight, false, {}, {}}}) {
}

ceres::LossFunction* ProgressiveSchedule::AddLoss(TermIndex index,
                                                  double divisor) {
  auto* loss = new ceres::LossFunctionWrapper(nullptr, ceres::TAKE_OWNERSHIP);
  terms_[index].losses.push_back({loss, divisor});
  return loss;
}

void ProgressiveSchedule::AddBlock(
    TermIndex index,
    ceres::CostFunction* cost_function,
    ceres::LossFunction* loss,
    const std::vector<double*>& parameter_blocks) {
  terms_[index].blocks.push_back(
      problem_->AddResidualBlock(cost_function, loss, parameter_blocks));
}

ceres::LossFunction* ProgressiveSchedule::BeginFrame(size_t num_observations) {
  num_observations_ = static_cast<double>(num_observations);
  featuremetric_loss_ = nullptr;
  return AddLoss(kReprojection, num_frames_ * num_observations_);
}

void ProgressiveSchedule::AddFeaturemetric(
    const std::shared_ptr<const CostMaps>& cost_maps,
    size_t cost_map_idx,
    const ImageBlocks& image,
    double* point) {
  if (terms_[kFeaturemetric].weight == 0.0) return;
  if (featuremetric_loss_ == nullptr) {
    featuremetric_loss_ =
        AddLoss(kFeaturemetric, num_frames_ * num_observations_);
  }
  AddBlock(kFeaturemetric,
           new FeaturemetricCost(
               (*cameras_)[image.camera_idx].model, cost_maps, cost_map_idx),
           featuremetric_loss_,
           {image.qvec, image.tvec, point, image.params});
}

void ProgressiveSchedule::EndFrame(const std::vector<ImageBlocks>& images,
                                   const std::vector<double*>& points) {
  // Blocks come back in the order in which they were added; all that no other
  // term owns are this frame's reprojection blocks.
  std::vector<ceres::ResidualBlockId> all_blocks;
  problem_->GetResidualBlocks(&all_blocks);
  size_t num_known = 0;
  for (const Term& term : terms_) num_known += term.blocks.size();
  std::vector<ceres::ResidualBlockId>& blocks = terms_[kReprojection].blocks;
  blocks.insert(blocks.end(), all_blocks.begin() + num_known, all_blocks.end());
  points_.insert(points_.end(), points.begin(), points.end());

  const double divisor = num_frames_ * static_cast<double>(images.size());
  // The problem owns those that a block has.
  const auto add_loss = [&](TermIndex index) {
    return terms_[index].weight > 0.0 && !images.empty()
               ? AddLoss(index, divisor)
               : nullptr;
  };
  ceres::LossFunction* rotation_loss = add_loss(kRotationPrior);
  ceres::LossFunction* translation_loss = add_loss(kTranslationPrior);
  for (const ImageBlocks& image : images) {
    images_.push_back(image.qvec);
    images_.push_back(image.tvec);
    images_.push_back(image.params);
    const Rigid3& known = (*cameras_)[image.camera_idx].cam_from_world;
    if (rotation_loss != nullptr) {
      AddBlock(kRotationPrior,
               RotationPriorCost::Create(known.rotation),
               rotation_loss,
               {image.qvec});
    }
    if (translation_loss != nullptr) {
      AddBlock(kTranslationPrior,
               TranslationPriorCost::Create(known.translation),
               translation_loss,
               {image.tvec});
    }
    AddVariance(image);
  }
}

void ProgressiveSchedule::AddVariance(const ImageBlocks& image) {
  RigCamera& camera = (*cameras_)[image.camera_idx];
  const std::vector<double> scales = PixelScales(camera);
  const auto add = [&](TermIndex index,
                       bool refine,
                       const std::vector<size_t>& idxs) {
    if (terms_[index].weight == 0.0 || !refine || idxs.empty()) return;
    IntrinsicsVarianceCost::Terms variance_terms;
    for (const size_t idx : idxs) {
      variance_terms.emplace_back(idx, scales[idx]);
    }
    AddBlock(
        index,
        IntrinsicsVarianceCost::Create(camera.params.size(), variance_terms),
        AddLoss(index, num_frames_ * static_cast<double>(cameras_->size())),
        {image.params, camera.params.data()});
    global_camera_idxs_.insert(image.camera_idx);
  };
  const CameraModel& model = *camera.model;
  add(kFocalVariance, options_.refine_focal_length, model.FocalLengthIdxs());
  add(kPrincipalPointVariance,
      options_.refine_principal_point,
      model.PrincipalPointIdxs());
  add(kExtraParamsVariance,
      options_.refine_extra_params,
      model.ExtraParamsIdxs());
}

// Global parameters without a variance term would be undetermined.
void ProgressiveSchedule::HoldUnrefinedGlobals() {
  for (const size_t camera_idx : global_camera_idxs_) {
    RigCamera& camera = (*cameras_)[camera_idx];
    const CameraModel& model = *camera.model;
    std::vector<int> constant_idxs;
    const auto hold =
        [&](TermIndex index, bool refine, const std::vector<size_t>& idxs) {
          if (terms_[index].weight > 0.0 && refine) return;
          constant_idxs.insert(constant_idxs.end(), idxs.begin(), idxs.end());
        };
    hold(kFocalVariance, options_.refine_focal_length, model.FocalLengthIdxs());
    hold(kPrincipalPointVariance,
         options_.refine_principal_point,
         model.PrincipalPointIdxs());
    hold(kExtraParamsVariance,
         options_.refine_extra_params,
         model.ExtraParamsIdxs());
    if (!constant_idxs.empty()) {
      problem_->SetManifold(
          camera.params.data(),
          new ceres::SubsetManifold(static_cast<int>(camera.params.size()),
                                    constant_idxs));
    }
  }
}

void ProgressiveSchedule::SetWeights() {
  for (const Term& term : terms_) {
    for (const Loss& loss : term.losses) {
      loss.loss->Reset(
          new ceres::ScaledLoss(new ceres::CauchyLoss(options_.loss_scale),
                                term.weight / loss.divisor,
                                ceres::TAKE_OWNERSHIP),
          ceres::TAKE_OWNERSHIP);
    }
  }
}

double ProgressiveSchedule::Cost(const Term& term) const {
  double cost = 0.0;
  problem_->Evaluate(EvaluateOptions(term), &cost, nullptr, nullptr, nullptr);
  return cost;
}

double ProgressiveSchedule::ReprojectionRms() const {
  ceres::Problem::EvaluateOptions evaluate_options =
      EvaluateOptions(terms_[kReprojection]);
  evaluate_options.apply_loss_function = false;
  std::vector<double> residuals;
  problem_->Evaluate(evaluate_options, nullptr, &residuals, nullptr, nullptr);
  std::vector<double> squared_residuals;
  for (size_t i = 0; i + 1 < residuals.size(); i += 2) {
    squared_residuals.push_back(residuals[i] * residuals[i] +
                                residuals[i + 1] * residuals[i + 1]);
  }
  return InlierRms(squared_residuals);
}

ceres::Problem::EvaluateOptions ProgressiveSchedule::EvaluateOptions(
    const Term& term) const {
  ceres::Problem::EvaluateOptions evaluate_options;
  evaluate_options.residual_blocks = term.blocks;
  evaluate_options.num_threads = kNumThreads;
  return evaluate_options;
}

void ProgressiveSchedule::SetSolverOptions(
    ceres::Solver::Options* solver_options) const {
  solver_options->max_num_iterations = options_.max_num_iterations;
  solver_options->num_threads = kNumThreads;
  solver_options->function_tolerance = kFunctionTolerance;
  // With the points eliminated first, a sparse factorization of the rest takes
  // each frame's cameras before the globals, through which alone the frames
  // couple: linear in the number of frames.
  solver_options->linear_solver_type = ceres::SPARSE_SCHUR;
  auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  for (double* point : points_) {
    ordering->AddElementToGroup(point, 0);
  }
  for (double* block : images_) {
    ordering->AddElementToGroup(block, 1);
  }
  for (const size_t camera_idx : global_camera_idxs_) {
    ordering->AddElementToGroup((*cameras_)[camera_idx].params.data(), 1);
  }
  solver_options->linear_solver_ordering = ordering;
}

void ProgressiveSchedule::Run(ceres::Solver::Options solver_options,
                              const StageCallback& callback) {
  HoldUnrefinedGlobals();
  SetSolverOptions(&solver_options);
  const int num_solves = options_.NumScheduleSolves();
  for (int i = 0; i < num_solves; ++i) {
    SetWeights();
    ceres::Solver::Summary summary;
    ceres::Solve(solver_options, problem_, &summary);

    Stage stage;
    stage.name = "schedule";
    for (const Term& term : terms_) {
      if (term.blocks.empty()) continue;
      stage.weights.emplace_back(term.name, term.weight);
      stage.costs.emplace_back(term.name, Cost(term));
    }
    stage.num_iterations =
        summary.num_successful_steps + summary.num_unsuccessful_steps;
    stage.time_s = summary.total_time_in_seconds;
    stage.termination = summary.termination_type == ceres::CONVERGENCE
                            ? "converged"
                            : "max_num_iterations";
    stage.rms_px = ReprojectionRms();
    if (!summary.IsSolutionUsable()) {
      stage.termination = "failed";
    }
    callback(stage);
    if (stage.termination == "failed") {
      throw SolverError("Solve " + std::to_string(i + 1) + " of " +
                        std::to_string(num_solves) +
                        " of the schedule failed: " + summary.message);
    }
    for (Term& term : terms_) {
      if (term.grows) term.weight *= options_.weight_growth;
    }
  }
}

}  // namespace mfir
