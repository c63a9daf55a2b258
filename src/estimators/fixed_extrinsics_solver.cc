#include "src/estimators/fixed_extrinsics_solver.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include <Eigen/Cholesky>
#include <Eigen/Dense>
#include <Eigen/Eigenvalues>

#include "src/estimators/free_params.h"
#include "src/estimators/normal_equations.h"
#include "src/estimators/point_elimination.h"
#include "src/residuals/linearization.h"

namespace mfir {
namespace {

// Damping as a factor on the diagonal of the normal equations; below the
// smallest value it is off.
constexpr double kInitialDamping = 1e-4;
constexpr double kMaxDamping = 1e12;
// A change of the cost below this share of it is lost in the rounding of its
// terms and in the tolerance of the points.
constexpr double kCostResolution = 1e-11;
// How often such a step may be no shorter than the shortest before.
constexpr int kMaxNumLongerSteps = 50;
constexpr int kNumCostIterations = 50;
// Tracks left out because a solve stalls.
constexpr int kMaxNumObstacles = 20;
// Points whose minima are about to vanish: far from the solution a quadratic
// model of them tells nothing, and they get the curvature without the second
// derivative of the loss where they have less than this share of it. Near it,
// in standard deviations, that would only make steps too long or too short.
constexpr double kMinCurvatureShare = 0.1;
constexpr double kNearStds = 0.1;

// A start is contradicted by data that are this many standard deviations off.
constexpr double kContradictionStds = 4.0;

// Less of the second derivative of the loss.
Curvature Next(Curvature curvature) {
  return curvature == Curvature::kNewton ? Curvature::kClamped
                                         : Curvature::kReweighted;
}

class Solver {
 public:
  Solver(const FixedExtrinsicsOptions& options,
         const Scene& scene,
         Estimate start);

  FixedExtrinsicsSummary Solve();

 private:
  using States = PointElimination::States;
  using Points = PointElimination::Points;

  NormalEquations BuildNormalEquations(Curvature curvature, double min_share);
  double PriorCost(const States& states) const;
  Eigen::MatrixXd PriorHessian() const;
  Eigen::VectorXd PlausibleStds() const;
  // Finds the directions that min_information holds, and moves the cameras back
  // to their start along them.
  void HoldUndetermined();
  Eigen::VectorXd DifferenceFromStart() const;
  bool FocalLengthsLeap(const States& new_states) const;
  // In the directions that are not held.
  bool ComputeFreeStep(const NormalEquations& equations,
                       double damping,
                       Eigen::VectorXd* step) const;

  // The same bytes on all ranks.
  bool ComputeCommonStep(const NormalEquations& equations,
                         double damping,
                         Eigen::VectorXd* step) const;

  // Cost after the step, infinite if it leads astray.
  double TryStep(const Eigen::VectorXd& step,
                 const States& new_states,
                 Points* new_points) const;
  // Moves points to lower minima: whether any changed.
  bool ImprovePoints(double* cost);
  // Steps until convergence, the largest number of iterations, or until no step
  // helps.
  void Iterate(double* cost, FixedExtrinsicsSummary* summary);
  void SetCameras();
  bool IsSlow(int num_iterations, double cost);
  bool LeaveOutObstacle(double* cost);
  double MaxFocalChange(const Eigen::VectorXd& step) const;
  bool IsBelowFloor(const Eigen::VectorXd& step) const;
  Eigen::MatrixXd Covariance();
  std::vector<bool> HeldCameras() const;

  const FixedExtrinsicsOptions options_;
  const Scene& scene_;
  Estimate estimate_;
  States states_;
  PointElimination points_;
  const ReducedParams& params_;
  // Columns: orthonormal directions in units of the plausible standard
  // deviations. free_directions_ is empty if none is held.
  Eigen::MatrixXd held_directions_;
  Eigen::MatrixXd free_directions_;
  // Where IsSlow has last compared costs.
  double earlier_cost_ = std::numeric_limits<double>::infinity();
  int earlier_iteration_ = 0;
  bool is_slow_ = false;
  int num_obstacles_ = 0;
};

Solver::Solver(const FixedExtrinsicsOptions& options,
               const Scene& scene,
               Estimate start)
    : options_(options),
      scene_(scene),
      estimate_(std::move(start)),
      states_(CameraStates(estimate_.cameras)),
      points_(options_, states_, scene_, &estimate_),
      params_(points_.Params()) {}

NormalEquations Solver::BuildNormalEquations(Curvature curvature,
                                             double min_share) {
  NormalEquations equations =
      points_.BuildNormalEquations(states_, curvature, min_share);
  equations.hessian += PriorHessian();
  const Eigen::VectorXd residuals =
      PriorResiduals(params_.params, scene_, states_);
  for (Eigen::Index i = 0; i < params_.Size(); ++i) {
    const double std = params_.params[i].prior_std;
    if (std == 0.0) continue;
    equations.gradient(i) += options_.prior_weight * residuals(i) / std;
  }
  return equations;
}

double Solver::PriorCost(const States& states) const {
  return 0.5 * options_.prior_weight *
         PriorResiduals(params_.params, scene_, states).squaredNorm();
}

Eigen::MatrixXd Solver::PriorHessian() const {
  const Eigen::Index num_params = params_.Size();
  Eigen::MatrixXd hessian = Eigen::MatrixXd::Zero(num_params, num_params);
  for (Eigen::Index i = 0; i < num_params; ++i) {
    const double std = params_.params[i].prior_std;
    if (std != 0.0) hessian(i, i) = options_.prior_weight / (std * std);
  }
  return hessian;
}

Eigen::VectorXd Solver::PlausibleStds() const {
  Eigen::VectorXd stds(params_.Size());
  for (Eigen::Index i = 0; i < params_.Size(); ++i) {
    stds(i) = params_.params[i].plausible_std;
  }
  return stds;
}

// Eigenvectors of the information along which one standard deviation moves some
// parameter further than is plausible. (Those that are common to many cameras
// move each of them by little.) Unless the start is so bad that even such data
// contradict it.
void Solver::HoldUndetermined() {
  const Eigen::Index num_params = params_.Size();
  const Eigen::VectorXd scale = PlausibleStds();
  const Eigen::MatrixXd information =
      scale.asDiagonal() *
      BuildNormalEquations(Curvature::kReweighted, kMinCurvatureShare)
          .hessian.selfadjointView<Eigen::Lower>()
          .toDenseMatrix() *
      scale.asDiagonal() / options_.prior_weight;
  const Eigen::MatrixXd rest =
      information - Eigen::MatrixXd::Identity(num_params, num_params);
  if (Eigen::LLT<Eigen::MatrixXd>(rest).info() == Eigen::Success) return;
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(information);
  const Eigen::VectorXd from_start =
      scale.cwiseInverse().cwiseProduct(DifferenceFromStart());
  std::vector<Eigen::Index> held;
  std::vector<Eigen::Index> free;
  for (Eigen::Index k = 0; k < num_params; ++k) {
    const double information_k = std::max(0.0, eigen.eigenvalues()(k));
    const auto direction = eigen.eigenvectors().col(k);
    const bool undetermined = information_k < direction.cwiseAbs2().maxCoeff();
    const bool contradicted =
        std::abs(direction.dot(from_start)) * std::sqrt(information_k) >
        kContradictionStds;
    (undetermined && !contradicted ? held : free).push_back(k);
  }
  held_directions_ = eigen.eigenvectors()(Eigen::all, held);
  free_directions_ = eigen.eigenvectors()(Eigen::all, free);
  const Eigen::VectorXd held_difference =
      held_directions_ * (held_directions_.transpose() * from_start);
  const States moved =
      AddStep(params_, -scale.cwiseProduct(held_difference), states_);
  if (!FocalLengthsLeap(moved)) states_ = moved;
}

// A focal length that more than halves or doubles has left the region in which
// a linearization means anything.
bool Solver::FocalLengthsLeap(const States& new_states) const {
  return std::any_of(params_.params.begin(),
                     params_.params.end(),
                     [&](const FreeParam& param) {
                       const double ratio =
                           new_states[param.camera_idx].params[param.idx] /
                           states_[param.camera_idx].params[param.idx];
                       return param.type == FreeParam::kFocalLength &&
                              !(ratio > 0.5 && ratio < 2.0);
                     });
}

Eigen::VectorXd Solver::DifferenceFromStart() const {
  Eigen::VectorXd difference = Eigen::VectorXd::Zero(params_.Size());
  for (Eigen::Index i = 0; i < params_.Size(); ++i) {
    const FreeParam& param = params_.params[i];
    if (param.IsPose()) continue;
    difference(i) = states_[param.camera_idx].params[param.idx] -
                    scene_.cameras[param.camera_idx].params[param.idx];
  }
  return difference;
}

bool Solver::ComputeFreeStep(const NormalEquations& equations,
                             double damping,
                             Eigen::VectorXd* step) const {
  if (held_directions_.cols() == 0) {
    return ComputeStep(equations, damping, step);
  }
  const Eigen::MatrixXd basis = PlausibleStds().asDiagonal() * free_directions_;
  NormalEquations free_equations;
  free_equations.hessian =
      basis.transpose() *
      (equations.hessian.selfadjointView<Eigen::Lower>() * basis);
  free_equations.gradient = basis.transpose() * equations.gradient;
  Eigen::VectorXd free_step;
  if (!ComputeStep(free_equations, damping, &free_step)) return false;
  *step = basis * free_step;
  return true;
}

// All ranks have the same equations, but on machines that differ not the same
// last digits of the solution: they would part.
bool Solver::ComputeCommonStep(const NormalEquations& equations,
                               double damping,
                               Eigen::VectorXd* step) const {
  const Communicator& ranks = *scene_.ranks;
  if (ranks.IsAlone()) return ComputeFreeStep(equations, damping, step);
  std::string bytes;
  if (ranks.IsFirst() && ComputeFreeStep(equations, damping, step)) {
    bytes.assign(reinterpret_cast<const char*>(step->data()),
                 sizeof(double) * static_cast<size_t>(step->size()));
  }
  ranks.Broadcast(&bytes);
  step->resize(params_.Size());
  if (!bytes.empty()) std::memcpy(step->data(), bytes.data(), bytes.size());
  return !bytes.empty();
}

double Solver::TryStep(const Eigen::VectorXd& step,
                       const States& new_states,
                       Points* new_points) const {
  if (FocalLengthsLeap(new_states)) {
    return std::numeric_limits<double>::infinity();
  }
  const double cost =
      PriorCost(new_states) + points_.TryStep(step, new_states, new_points);
  return std::isnan(cost) ? std::numeric_limits<double>::infinity() : cost;
}

bool Solver::ImprovePoints(double* cost) {
  if (!points_.ImprovePoints(states_, cost)) return false;
  *cost += PriorCost(states_);
  return true;
}

void Solver::SetCameras() {
  for (size_t i = 0; i < estimate_.cameras.size(); ++i) {
    RigCamera& camera = estimate_.cameras[i];
    camera.params = states_[i].params;
    if (params_.by_camera[i].pose) {
      camera.cam_from_world.rotation = Eigen::Quaterniond(states_[i].rotation);
      camera.cam_from_world.translation = states_[i].translation;
    }
  }
}

// Whether the last kNumCostIterations have changed next to nothing.
bool Solver::IsSlow(int num_iterations, double cost) {
  if (options_.cost_tolerance == 0.0 ||
      num_iterations < earlier_iteration_ + kNumCostIterations) {
    return false;
  }
  const bool is_slow = cost >= earlier_cost_ * (1.0 - options_.cost_tolerance);
  earlier_cost_ = cost;
  earlier_iteration_ = num_iterations;
  return is_slow;
}

double Solver::MaxFocalChange(const Eigen::VectorXd& step) const {
  double max_change = 0.0;
  for (Eigen::Index i = 0; i < params_.Size(); ++i) {
    const FreeParam& param = params_.params[i];
    if (param.type != FreeParam::kFocalLength) continue;
    max_change = std::max(max_change, std::abs(step(i)) / param.focal_length);
  }
  return max_change;
}

bool Solver::IsBelowFloor(const Eigen::VectorXd& step) const {
  double max_change = 0.0;
  for (Eigen::Index i = 0; i < params_.Size(); ++i) {
    const FreeParam& param = params_.params[i];
    max_change = std::max(
        max_change, std::abs(step(i)) * param.pixels / param.focal_length);
  }
  return max_change < options_.parameter_tolerance;
}

Eigen::MatrixXd Solver::Covariance() {
  Eigen::MatrixXd prior_information = PriorHessian();
  // Of a held direction it is only known that the data say less than this: its
  // parameters have the plausible standard deviation.
  for (Eigen::Index k = 0; k < held_directions_.cols(); ++k) {
    const Eigen::VectorXd direction = held_directions_.col(k);
    const Eigen::VectorXd gradient =
        direction.cwiseAbs().maxCoeff() *
        PlausibleStds().cwiseInverse().cwiseProduct(direction);
    prior_information +=
        options_.prior_weight * gradient * gradient.transpose();
  }
  const Eigen::MatrixXd gradient_outer =
      points_.GradientOuter(states_) +
      options_.prior_weight * prior_information;
  Eigen::MatrixXd covariance;
  for (const Curvature curvature :
       {Curvature::kNewton, Curvature::kReweighted}) {
    const Eigen::MatrixXd hessian =
        points_.BuildNormalEquations(states_, curvature, kMinCurvatureShare)
            .hessian +
        prior_information;
    if (SandwichCovariance(hessian, gradient_outer, &covariance)) {
      return IntrinsicsCovariance(
          params_.params, estimate_.cameras, covariance);
    }
  }
  covariance.setConstant(
      params_.Size(), params_.Size(), std::numeric_limits<double>::quiet_NaN());
  return IntrinsicsCovariance(params_.params, estimate_.cameras, covariance);
}

// The length of a Newton step dK in standard deviations: with the covariance
// w H^-1 (w = prior_weight) it is
//
//   max over all c of |c^T dK| / sqrt(w c^T H^-1 c) = sqrt(dK^T H dK / w)
//                                                   = sqrt(-g^T dK / w).
//
// Near the solution the cost cannot judge steps: half of the squared length,
// its expected decrease, is 1e-8 for a step of 1e-4 standard deviations, and
// lost in the rounding of a cost of 1e4 or more. Such steps are taken as they
// are, and have to become shorter. (Judged by the cost they were rejected by
// chance, and damped for ever.)
void Solver::Iterate(double* cost, FixedExtrinsicsSummary* summary) {
  Points new_points;
  double damping = 0.0;
  Curvature curvature = Curvature::kNewton;
  double shortest = std::numeric_limits<double>::infinity();
  int num_longer_steps = 0;
  while (!summary->converged &&
         summary->num_iterations < options_.max_num_iterations) {
    is_slow_ = IsSlow(summary->num_iterations, *cost);
    summary->converged = is_slow_;
    if (is_slow_) return;
    ++summary->num_iterations;
    const bool is_near =
        summary->last_step_stds > 0.0 && summary->last_step_stds < kNearStds;
    const NormalEquations equations =
        BuildNormalEquations(curvature, is_near ? 0.0 : kMinCurvatureShare);
    Eigen::VectorXd step;
    if (!ComputeCommonStep(equations, damping, &step)) {
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
    const bool full = damping < kMinDamping;
    const double length = std::sqrt(
        std::max(0.0, -equations.gradient.dot(step) / options_.prior_weight));
    if (full) {
      summary->last_step_stds = length;
      summary->last_focal_change = MaxFocalChange(step);
    }
    // Damped steps are no measure of anything.
    const bool below_floor = full && IsBelowFloor(step);
    const double expected_decrease =
        0.5 * length * length * options_.prior_weight;
    const bool judged =
        !full || (!below_floor && expected_decrease > kCostResolution * *cost);
    const bool is_newton = full && curvature == Curvature::kNewton;
    const bool is_small = is_newton && length <= options_.step_tolerance;
    if (!judged && !is_small && length >= shortest) {
      if (++num_longer_steps > kMaxNumLongerSteps) break;
      // A Newton step that is too long, time and again. Shorter ones lead on.
      if (curvature != Curvature::kReweighted) {
        curvature = Next(curvature);
        continue;
      }
    }
    const States new_states = AddStep(params_, step, states_);
    const double new_cost = TryStep(step, new_states, &new_points);
    if (new_cost <= *cost || (!judged && std::isfinite(new_cost))) {
      summary->converged =
          below_floor || (full && length <= options_.step_tolerance);
      if (!judged && is_newton) shortest = std::min(shortest, length);
      states_ = new_states;
      points_.SetPoints(new_points);
      *cost = new_cost;
      damping *= 0.03;
      curvature = Curvature::kNewton;
    } else if (curvature != Curvature::kReweighted) {
      curvature = Next(curvature);
    } else {
      damping = std::max(10.0 * damping, kInitialDamping);
      if (damping > kMaxDamping) break;
    }
  }
}

// Short of a minimum no step lowers the cost where the minimum of a point
// vanishes, and its cost leaps, just ahead of the solution.
bool Solver::LeaveOutObstacle(double* cost) {
  if (num_obstacles_ == kMaxNumObstacles) return false;
  ++num_obstacles_;
  const NormalEquations equations =
      BuildNormalEquations(Curvature::kReweighted, kMinCurvatureShare);
  Eigen::VectorXd step;
  if (!ComputeCommonStep(equations, 0.0, &step)) return false;
  *cost = PriorCost(states_) +
          points_.LeaveOutObstacle(step,
                                   states_,
                                   AddStep(params_, step, states_),
                                   AddStep(params_, -step, states_));
  return true;
}

// Cameras that move are followed by their points, each in the minimum that it
// is in; in between, points are moved to lower minima, until there are none.
// Both lower the cost, so that no minimum comes back.
FixedExtrinsicsSummary Solver::Solve() {
  FixedExtrinsicsSummary summary;
  double cost = PriorCost(states_) + points_.MinimizePoints(states_);
  ImprovePoints(&cost);
  if (options_.min_information != 0.0 && params_.Size() > 0) {
    HoldUndetermined();
    cost = PriorCost(states_) + points_.MinimizePoints(states_);
    ImprovePoints(&cost);
  }
  summary.initial_cost = cost;
  do {
    summary.converged = params_.Size() == 0;
    Iterate(&cost, &summary);
    const bool improved = ImprovePoints(&cost);
    if (is_slow_) break;
    const bool stalls = !summary.converged && !improved &&
                        summary.num_iterations < options_.max_num_iterations;
    if (!improved && !(stalls && LeaveOutObstacle(&cost))) break;
    summary.converged = false;
  } while (summary.num_iterations < options_.max_num_iterations);
  SetCameras();
  summary.final_cost = cost;
  summary.final_feature_cost = points_.FeatureCost(states_);
  summary.num_tracks_left_out = points_.NumLeftOut();
  summary.held_cameras = HeldCameras();
  if (options_.compute_covariance) summary.covariance = Covariance();
  summary.estimate = std::move(estimate_);
  return summary;
}

// Those that have a large share in a held direction.
std::vector<bool> Solver::HeldCameras() const {
  constexpr double kMinShare = 0.25;  // of that of the largest parameter
  std::vector<bool> held_cameras(scene_.cameras.size(), false);
  for (Eigen::Index k = 0; k < held_directions_.cols(); ++k) {
    const Eigen::VectorXd shares = held_directions_.col(k).cwiseAbs2();
    for (Eigen::Index i = 0; i < params_.Size(); ++i) {
      if (shares(i) >= kMinShare * shares.maxCoeff()) {
        held_cameras[params_.params[i].camera_idx] = true;
      }
    }
  }
  return held_cameras;
}

}  // namespace

FixedExtrinsicsSummary SolveFixedExtrinsics(
    const FixedExtrinsicsOptions& options, const Scene& scene, Estimate start) {
  return Solver(options, scene, std::move(start)).Solve();
}

}  // namespace mfir
