// The paper's progressive schedule: one ceres::Problem, solved again and again
// while the weights of the priors grow.

#pragma once

#include <memory>
#include <set>
#include <string>
#include <vector>

#include <ceres/loss_function.h>
#include <ceres/problem.h>
#include <ceres/solver.h>

#include "src/refinement/options.h"
#include "src/refinement/stage.h"
#include "src/scene/scene.h"

namespace mfir {

// Memory of the variables of one image inside the problem.
struct ImageBlocks {
  size_t camera_idx = 0;   // into Scene::cameras
  double* qvec = nullptr;  // cam_from_world rotation (w, x, y, z)
  double* tvec = nullptr;
  double* params = nullptr;
};

// Objective (eq. 10, cost = 1/2 rho as in Ceres, rho = Cauchy(loss_scale)):
//
//     reprojection_weight / (N_F |obs_i|)   sum |Pi(r_ij, t_ij, K_ij, x) - p|
//   + rotation_prior_weight / (N_F N_C,i)   sum |log(R_ij Rhat_j^T)|
//   + translation_prior_weight / (N_F N_C,i) sum |t_ij - that_j|
//   + *_variance_weight / (N_F N_C)         sum |K_ij - Kbar_j|
//   + featuremetric_weight / (N_F |obs_i|)  sum |G_ijx(Pi(...))|
//
// Terms with weight zero are left out. Usage: for each frame, BeginFrame, add
// the frame's reprojection blocks to the problem with the loss it returns,
// EndFrame, and AddFeaturemetric for observations with a cost map; then Run.
class ProgressiveSchedule {
 public:
  // `cameras`: the rig in the coordinates of the problem, with the initial
  // global intrinsics; updated by Run. `problem` and `cameras` must outlive
  // this.
  ProgressiveSchedule(const MultiFrameOptions& options,
                      size_t num_frames,
                      std::vector<RigCamera>* cameras,
                      ceres::Problem* problem);

  // Loss for the reprojection blocks of the next frame, owned by the problem.
  ceres::LossFunction* BeginFrame(size_t num_observations);
  // Registers the blocks added since BeginFrame and adds the frame's priors.
  void EndFrame(const std::vector<ImageBlocks>& images,
                const std::vector<double*>& points);

  // Adds the featuremetric residual of an observation of the frame of the last
  // EndFrame, in blocks that its reprojection residual uses. `image`: one of
  // that call.
  void AddFeaturemetric(const std::shared_ptr<const CostMaps>& cost_maps,
                        size_t cost_map_idx,
                        const ImageBlocks& image,
                        double* point);

  // All solves, each reported. Of `solver_options` the linear solver, number of
  // iterations and threads, and function tolerance are set here. Throws
  // SolverError when a solve fails.
  void Run(ceres::Solver::Options solver_options,
           const StageCallback& callback);

 private:
  struct Loss {
    ceres::LossFunctionWrapper* loss;  // owned by the problem
    double divisor;                    // of the term's weight
  };
  // A weighted sum of residual blocks.
  struct Term {
    std::string name;  // as in summary.json
    double weight;
    bool grows;
    std::vector<Loss> losses;
    std::vector<ceres::ResidualBlockId> blocks;
  };
  enum TermIndex {
    kReprojection,
    kRotationPrior,
    kTranslationPrior,
    kFocalVariance,
    kPrincipalPointVariance,
    kExtraParamsVariance,
    kFeaturemetric
  };

  ceres::LossFunction* AddLoss(TermIndex index, double divisor);
  void AddBlock(TermIndex index,
                ceres::CostFunction* cost_function,
                ceres::LossFunction* loss,
                const std::vector<double*>& parameter_blocks);
  void AddVariance(const ImageBlocks& image);
  void HoldUnrefinedGlobals();
  void SetWeights();
  ceres::Problem::EvaluateOptions EvaluateOptions(const Term& term) const;
  double Cost(const Term& term) const;
  double ReprojectionRms() const;
  void SetSolverOptions(ceres::Solver::Options* solver_options) const;

  const MultiFrameOptions options_;
  const double num_frames_;
  double num_observations_ = 0.0;  // of the last frame
  std::vector<RigCamera>* cameras_;
  ceres::Problem* problem_;
  std::vector<Term> terms_;
  // Of the last frame; null until it has a featuremetric residual.
  ceres::LossFunction* featuremetric_loss_ = nullptr;
  std::vector<double*> points_;
  std::vector<double*> images_;
  std::set<size_t> global_camera_idxs_;
};

}  // namespace mfir
