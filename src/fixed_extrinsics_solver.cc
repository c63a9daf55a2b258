#include "fixed_extrinsics_solver.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <Eigen/Cholesky>
#include <Eigen/Dense>
#include <Eigen/Eigenvalues>

#include "free_params.h"
#include "linearization.h"
#include "normal_equations.h"
#include "point_elimination.h"

namespace mfir {
namespace {

// Damping as a factor on the diagonal of the normal equations; below the
// smallest value it is off.
constexpr double kInitialDamping = 1e-4;
constexpr double kMaxDamping = 1e12;
// What holds a direction, relative to the largest information.
constexpr double kHoldingFactor = 1e6;

class Solver {
 public:
  Solver(const FixedExtrinsicsOptions& options, Scene* scene);

  FixedExtrinsicsSummary Solve();

 private:
  using States = PointElimination::States;
  using Points = PointElimination::Points;

  NormalEquations BuildNormalEquations(Curvature curvature);
  double PriorCost(const States& states) const;
  // Of priors and held directions.
  Eigen::MatrixXd PriorHessian() const;
  // Finds the directions that min_information holds.
  void FindHeldDirections();

  // Cost after the step, infinite if it leads astray.
  double TryStep(const Eigen::VectorXd& step,
                 const States& new_states,
                 Points* new_points) const;
  // Moves points to lower minima: whether any moved.
  bool ImprovePoints(double* cost);
  // Steps until convergence or the largest number of iterations.
  void Iterate(double* cost, FixedExtrinsicsSummary* summary);
  void SetCameras();
  bool IsSmall(const Eigen::VectorXd& step, double* focal_change) const;
  Eigen::MatrixXd Covariance();

  const FixedExtrinsicsOptions options_;
  Scene* scene_;
  States states_;
  PointElimination points_;
  const ReducedParams& params_;
  // Columns: held directions, in pixels.
  Eigen::MatrixXd held_directions_;
  double holding_information_ = 0.0;
};

Solver::Solver(const FixedExtrinsicsOptions& options, Scene* scene)
    : options_(options),
      scene_(scene),
      states_(CameraStates(*scene)),
      points_(options_, states_, scene),
      params_(points_.Params()) {
  if (options_.min_information > 0.0 && params_.Size() > 0) {
    FindHeldDirections();
  }
}

NormalEquations Solver::BuildNormalEquations(Curvature curvature) {
  NormalEquations equations = points_.BuildNormalEquations(states_, curvature);
  equations.hessian += PriorHessian();
  const Eigen::VectorXd residuals =
      PriorResiduals(params_.params, *scene_, states_);
  for (Eigen::Index i = 0; i < params_.Size(); ++i) {
    const double std = params_.params[i].prior_std;
    if (std == 0.0) continue;
    equations.gradient(i) += options_.prior_weight * residuals(i) / std;
  }
  return equations;
}

double Solver::PriorCost(const States& states) const {
  return 0.5 * options_.prior_weight *
         PriorResiduals(params_.params, *scene_, states).squaredNorm();
}

Eigen::MatrixXd Solver::PriorHessian() const {
  const Eigen::Index num_params = params_.Size();
  Eigen::MatrixXd hessian = Eigen::MatrixXd::Zero(num_params, num_params);
  for (Eigen::Index i = 0; i < num_params; ++i) {
    const double std = params_.params[i].prior_std;
    if (std != 0.0) hessian(i, i) = options_.prior_weight / (std * std);
  }
  if (held_directions_.cols() == 0) return hessian;
  Eigen::MatrixXd directions = held_directions_;
  for (Eigen::Index i = 0; i < num_params; ++i) {
    directions.row(i) *= params_.params[i].pixels;
  }
  return hessian + holding_information_ * directions * directions.transpose();
}

void Solver::FindHeldDirections() {
  const Eigen::Index num_params = params_.Size();
  Eigen::MatrixXd information = BuildNormalEquations(Curvature::kReweighted)
                                    .hessian.selfadjointView<Eigen::Lower>();
  for (Eigen::Index i = 0; i < num_params; ++i) {
    information.row(i) /= params_.params[i].pixels;
    information.col(i) /= params_.params[i].pixels;
  }
  const double min_information =
      options_.min_information * options_.prior_weight;
  const Eigen::MatrixXd rest =
      information -
      min_information * Eigen::MatrixXd::Identity(num_params, num_params);
  if (Eigen::LLT<Eigen::MatrixXd>(rest).info() == Eigen::Success) return;
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(information);
  Eigen::Index num_held = 0;
  while (num_held < num_params &&
         eigen.eigenvalues()(num_held) < min_information) {
    ++num_held;
  }
  held_directions_ = eigen.eigenvectors().leftCols(num_held);
  holding_information_ = kHoldingFactor * information.diagonal().maxCoeff();
}

double Solver::TryStep(const Eigen::VectorXd& step,
                       const States& new_states,
                       Points* new_points) const {
  for (const FreeParam& param : params_.params) {
    if (param.type != FreeParam::kFocalLength) continue;
    // A focal length that more than halves or doubles has left the region in
    // which the linearization means anything.
    const double ratio = new_states[param.camera_idx].params[param.idx] /
                         states_[param.camera_idx].params[param.idx];
    if (!(ratio > 0.5 && ratio < 2.0)) {
      return std::numeric_limits<double>::infinity();
    }
  }
  const double cost =
      PriorCost(new_states) + points_.TryStep(step, new_states, new_points);
  return std::isnan(cost) ? std::numeric_limits<double>::infinity() : cost;
}

bool Solver::ImprovePoints(double* cost) {
  if (!options_.improve_points || !points_.ImprovePoints(states_, cost)) {
    return false;
  }
  *cost += PriorCost(states_);
  return true;
}

void Solver::SetCameras() {
  for (size_t i = 0; i < scene_->cameras.size(); ++i) {
    RigCamera& camera = scene_->cameras[i];
    camera.params = states_[i].params;
    if (params_.by_camera[i].pose) {
      camera.cam_from_world.rotation = Eigen::Quaterniond(states_[i].rotation);
      camera.cam_from_world.translation = states_[i].translation;
    }
  }
}

bool Solver::IsSmall(const Eigen::VectorXd& step, double* focal_change) const {
  double max_change = 0.0;
  *focal_change = 0.0;
  for (Eigen::Index i = 0; i < params_.Size(); ++i) {
    const FreeParam& param = params_.params[i];
    const double change = std::abs(step(i)) * param.pixels / param.focal_length;
    max_change = std::max(max_change, change);
    if (param.type == FreeParam::kFocalLength) {
      *focal_change = std::max(*focal_change, change);
    }
  }
  return max_change < options_.parameter_tolerance;
}

Eigen::MatrixXd Solver::Covariance() {
  // Of a held direction it is only known that the data say less than this.
  holding_information_ = options_.min_information * options_.prior_weight;
  const Eigen::MatrixXd gradient_outer =
      points_.GradientOuter(states_) + options_.prior_weight * PriorHessian();
  Eigen::MatrixXd covariance;
  if (!SandwichCovariance(BuildNormalEquations(Curvature::kNewton).hessian,
                          gradient_outer,
                          &covariance) &&
      !SandwichCovariance(BuildNormalEquations(Curvature::kReweighted).hessian,
                          gradient_outer,
                          &covariance)) {
    covariance.setConstant(params_.Size(),
                           params_.Size(),
                           std::numeric_limits<double>::quiet_NaN());
  }
  return IntrinsicsCovariance(params_.params, *scene_, covariance);
}

void Solver::Iterate(double* cost, FixedExtrinsicsSummary* summary) {
  Points new_points;
  double damping = 0.0;
  Curvature curvature = Curvature::kNewton;
  bool tried_undamped = false;
  while (!summary->converged &&
         summary->num_iterations < options_.max_num_iterations) {
    ++summary->num_iterations;
    const NormalEquations equations = BuildNormalEquations(curvature);
    Eigen::VectorXd step;
    if (!ComputeStep(equations, damping, &step)) {
      // Far from the solution the second derivative of the loss makes the
      // system indefinite; less of it cannot.
      if (curvature == Curvature::kNewton) {
        curvature = Curvature::kClamped;
      } else {
        damping = std::max(10.0 * damping, kInitialDamping);
        if (damping > kMaxDamping) break;
      }
      continue;
    }
    const States new_states = AddStep(params_, step, states_);
    const double new_cost = TryStep(step, new_states, &new_points);
    const bool small_step = IsSmall(step, &summary->last_focal_change);
    // Rounding limits what the cost can resolve.
    if (new_cost <= *cost * (1.0 + 1e-13)) {
      summary->converged = small_step && damping < kMinDamping;
      states_ = new_states;
      points_.SetPoints(new_points);
      *cost = new_cost;
      damping *= 0.03;
      curvature = Curvature::kNewton;
      tried_undamped = false;
    } else if (small_step && damping < kMinDamping) {
      // The cost cannot resolve the step.
      summary->converged = true;
    } else if (small_step && !tried_undamped) {
      tried_undamped = true;
      damping = 0.0;
    } else if (curvature != Curvature::kReweighted) {
      curvature = curvature == Curvature::kNewton ? Curvature::kClamped
                                                  : Curvature::kReweighted;
    } else {
      damping = std::max(10.0 * damping, kInitialDamping);
      if (damping > kMaxDamping) {
        // Not even the smallest step helps: a minimum with a kink, where a
        // point has two minima of its own.
        summary->converged = small_step;
        break;
      }
    }
  }
}

FixedExtrinsicsSummary Solver::Solve() {
  FixedExtrinsicsSummary summary;
  double cost = PriorCost(states_) + points_.MinimizePoints(states_);
  if (std::isnan(cost)) cost = std::numeric_limits<double>::infinity();
  ImprovePoints(&cost);
  summary.initial_cost = cost;
  do {
    summary.converged = params_.Size() == 0;
    Iterate(&cost, &summary);
  } while (summary.num_iterations < options_.max_num_iterations &&
           ImprovePoints(&cost));
  SetCameras();
  summary.final_cost = cost;
  summary.final_feature_cost = points_.FeatureCost(states_);
  summary.held_cameras.assign(scene_->cameras.size(), false);
  for (Eigen::Index i = 0; i < params_.Size(); ++i) {
    if (held_directions_.cols() > 0 &&
        held_directions_.row(i).squaredNorm() > 0.1) {
      summary.held_cameras[params_.params[i].camera_idx] = true;
    }
  }
  if (options_.compute_covariance) summary.covariance = Covariance();
  return summary;
}

}  // namespace

FixedExtrinsicsSummary SolveFixedExtrinsics(
    const FixedExtrinsicsOptions& options, Scene* scene) {
  return Solver(options, scene).Solve();
}

}  // namespace mfir
