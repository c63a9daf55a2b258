#include "src/estimators/track_solver.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "src/residuals/featuremetric_residual.h"

namespace mfir {
namespace {

// Most intersections of rays lead to the same few minima.
constexpr size_t kMaxNumStarts = 3;

// A point is at its minimum when a step would lower its cost by less than this
// share, or by less than that of an observation this far (px) from its
// keypoint.
constexpr double kCostTolerance = 1e-12;
constexpr double kDistanceTolerance = 1e-10;
// Regular minima take two to ten.
constexpr int kMaxNumIterations = 50;
constexpr double kConvergedDamping = 1.0;  // of the diagonal
// Smallest depth relative to the largest of the same point.
constexpr double kMinDepthRatio = 0.02;

// Whether the point is next to the centre of a camera.
bool IsAtCamera(const std::vector<Linearization>& linearizations) {
  double min_depth = std::numeric_limits<double>::infinity();
  double max_depth = 0.0;
  for (const Linearization& linearization : linearizations) {
    min_depth = std::min(min_depth, linearization.depth);
    max_depth = std::max(max_depth, linearization.depth);
  }
  return min_depth < kMinDepthRatio * max_depth;
}

}  // namespace

Eigen::Matrix2d RobustHessian(const Eigen::Vector2d& residual,
                              const double rho[3],
                              Curvature curvature) {
  constexpr double kMinShare = 0.05;
  Eigen::Matrix2d hessian = rho[1] * Eigen::Matrix2d::Identity();
  const double squared_norm = residual.squaredNorm();
  if (curvature == Curvature::kReweighted || !(squared_norm > 0.0)) {
    return hessian;
  }
  double second = 2.0 * rho[2];
  if (curvature == Curvature::kClamped) {
    second = std::max(second, (kMinShare - 1.0) * rho[1] / squared_norm);
  }
  return hessian + second * residual * residual.transpose();
}

TrackSolver::TrackSolver(const TrackLosses& losses,
                         const Scene* scene,
                         std::vector<FreeParams> free_params)
    : losses_(losses), scene_(scene), free_params_(std::move(free_params)) {
  double rho[3];
  losses_.keypoints->Evaluate(0.0, rho);
  information_at_zero_ = rho[1];
}

double TrackSolver::Cost(const Track& track,
                         const std::vector<CameraState>& states,
                         const Eigen::Vector3d& xyz) const {
  double cost = 0.0;
  for (size_t i = 0; i < track.length; ++i) {
    const Track::Observation& observation = track.observations[i];
    const size_t camera_idx = observation.camera_idx;
    Eigen::Vector2d xy;
    if (!ProjectPoint(
            *scene_->cameras[camera_idx].model, states[camera_idx], xyz, &xy)) {
      return std::numeric_limits<double>::infinity();
    }
    double rho[3];
    losses_.keypoints->Evaluate((xy - observation.xy).squaredNorm(), rho);
    cost += 0.5 * rho[0];
    cost += FeatureCost(observation, xy);
  }
  return track.weight * cost;
}

double TrackSolver::FeatureCost(const Track::Observation& observation,
                                const Eigen::Vector2d& xy) const {
  double cost = 0.0;
  double rho[3];
  if (HasFeature(observation)) {
    const FeatureKeypoint& feature = *observation.feature;
    losses_.features->Evaluate(
        (feature.whitening * (xy - feature.xy)).squaredNorm(), rho);
    cost += 0.5 * rho[0];
  }
  if (HasCostMap(observation)) {
    Eigen::Vector3d residual;
    EvaluateFeaturemetric(*observation.cost_maps,
                          observation.cost_map_idx,
                          xy,
                          &residual,
                          nullptr);
    losses_.cost_maps->Evaluate(residual.squaredNorm(), rho);
    cost += 0.5 * rho[0];
  }
  return cost;
}

double TrackSolver::FeatureCost(const Track& track,
                                const std::vector<CameraState>& states,
                                const Eigen::Vector3d& xyz) const {
  double cost = 0.0;
  if (losses_.features == nullptr && losses_.cost_maps == nullptr) return 0.0;
  for (size_t i = 0; i < track.length; ++i) {
    const Track::Observation& observation = track.observations[i];
    const size_t camera_idx = observation.camera_idx;
    Eigen::Vector2d xy;
    if (ProjectPoint(
            *scene_->cameras[camera_idx].model, states[camera_idx], xyz, &xy)) {
      cost += FeatureCost(observation, xy);
    }
  }
  return track.weight * cost;
}

bool TrackSolver::Linearize(const Track& track,
                            const std::vector<CameraState>& states,
                            const Eigen::Vector3d& xyz,
                            std::vector<Linearization>* linearizations) const {
  linearizations->resize(track.length);
  for (size_t i = 0; i < track.length; ++i) {
    const Track::Observation& observation = track.observations[i];
    const size_t camera_idx = observation.camera_idx;
    if (!LinearizeObservation(*scene_->cameras[camera_idx].model,
                              states[camera_idx],
                              free_params_[camera_idx],
                              observation.xy,
                              xyz,
                              &(*linearizations)[i])) {
      return false;
    }
  }
  return true;
}

void TrackSolver::AddFeatureTerms(const Track& track,
                                  size_t observation_idx,
                                  const Eigen::Vector2d& xy,
                                  Curvature curvature,
                                  TrackSystem* system) const {
  const Track::Observation& observation = track.observations[observation_idx];
  TrackSystem::Observation& sum = system->observations[observation_idx];
  double rho[3];
  if (HasFeature(observation)) {
    const Eigen::Matrix2d& whitening = observation.feature->whitening;
    const Eigen::Vector2d whitened = whitening * (xy - observation.feature->xy);
    losses_.features->Evaluate(whitened.squaredNorm(), rho);
    sum.weight += track.weight * whitening.transpose() *
                  RobustHessian(whitened, rho, curvature) * whitening;
    sum.weighted_residual +=
        track.weight * rho[1] * whitening.transpose() * whitened;
  }
  if (HasCostMap(observation)) {
    Eigen::Vector3d residual;
    Matrix3x2 jacobian;
    EvaluateFeaturemetric(*observation.cost_maps,
                          observation.cost_map_idx,
                          xy,
                          &residual,
                          &jacobian);
    losses_.cost_maps->Evaluate(residual.squaredNorm(), rho);
    // Gauss-Newton: the second derivatives of the cost map are noise.
    sum.weight += track.weight * rho[1] * jacobian.transpose() * jacobian;
    sum.weighted_residual +=
        track.weight * rho[1] * jacobian.transpose() * residual;
  }
}

void TrackSolver::BuildSystem(const Track& track,
                              const std::vector<Linearization>& linearizations,
                              Curvature curvature,
                              double min_share,
                              double damping,
                              TrackSystem* system) const {
  system->observations.resize(linearizations.size());
  Eigen::Matrix3d hessian = Eigen::Matrix3d::Zero();
  Eigen::Matrix3d reweighted_hessian = Eigen::Matrix3d::Zero();
  for (const Curvature tried_curvature :
       {Curvature::kNewton, Curvature::kClamped, Curvature::kReweighted}) {
    if (tried_curvature < curvature) continue;
    hessian.setZero();
    reweighted_hessian.setZero();
    system->gradient.setZero();
    for (size_t i = 0; i < linearizations.size(); ++i) {
      const Eigen::Vector2d& residual = linearizations[i].residual;
      double rho[3];
      losses_.keypoints->Evaluate(residual.squaredNorm(), rho);
      TrackSystem::Observation& observation = system->observations[i];
      observation.weight =
          track.weight * RobustHessian(residual, rho, tried_curvature);
      observation.weighted_residual = track.weight * rho[1] * residual;
      AddFeatureTerms(track,
                      i,
                      residual + track.observations[i].xy,
                      tried_curvature,
                      system);
      const Matrix2x3& jacobian = linearizations[i].jacobian_point;
      hessian += jacobian.transpose() * observation.weight * jacobian;
      if (min_share > 0.0) {
        reweighted_hessian +=
            track.weight * rho[1] * jacobian.transpose() * jacobian;
      }
      system->gradient += jacobian.transpose() * observation.weighted_residual;
    }
    // Whatever the axes of the world.
    hessian.diagonal().array() += damping * hessian.trace() / 3.0;
    const bool enough =
        min_share == 0.0 || tried_curvature == Curvature::kReweighted ||
        Eigen::LLT<Eigen::Matrix3d>(hessian - min_share * reweighted_hessian)
                .info() == Eigen::Success;
    system->hessian.compute(hessian);
    if (enough && system->hessian.info() == Eigen::Success) return;
  }
  // No information along some direction even with positive weights.
  hessian.diagonal().array() += std::max(1e-12 * hessian.trace(), 1e-300);
  system->hessian.compute(hessian);
}

TrackSolver::Minimum TrackSolver::Minimize(
    const Track& track,
    const std::vector<CameraState>& states,
    Eigen::Vector3d* xyz) const {
  thread_local std::vector<Linearization> linearizations;
  thread_local TrackSystem system;
  const double min_decrease = track.weight * information_at_zero_ *
                              kDistanceTolerance * kDistanceTolerance;
  Minimum minimum;
  minimum.cost = Cost(track, states, *xyz);
  double& cost = minimum.cost;
  double damping = 0.0;
  bool moved = true;
  for (int i = 0; i < kMaxNumIterations && std::isfinite(cost); ++i) {
    if (moved) Linearize(track, states, *xyz, &linearizations);
    BuildSystem(
        track, linearizations, Curvature::kNewton, 0.0, damping, &system);
    const Eigen::Vector3d step = system.hessian.solve(system.gradient);
    const double expected_decrease = 0.5 * step.dot(system.gradient);
    const Eigen::Vector3d new_xyz = *xyz - step;
    const double new_cost = Cost(track, states, new_xyz);
    // The cost cannot resolve the last step, which gives the digits that count.
    const bool last =
        expected_decrease <= std::max(kCostTolerance * cost, min_decrease);
    moved = new_cost < cost || (last && new_cost <= cost * (1.0 + 1e-13));
    if (moved) {
      *xyz = new_xyz;
      cost = new_cost;
      damping *= 0.1;
    } else {
      damping = std::max(10.0 * damping, 1e-3);
    }
    if (last) {
      // Of a damped step little decrease is to be expected anywhere.
      minimum.converged = damping < kConvergedDamping &&
                          !IsAtCamera(linearizations) &&
                          !IsFolded(track, states, linearizations);
      break;
    }
  }
  return minimum;
}

bool TrackSolver::IsFolded(
    const Track& track,
    const std::vector<CameraState>& states,
    const std::vector<Linearization>& linearizations) const {
  constexpr double kMaxDifference = 0.01;  // relative
  for (size_t i = 0; i < track.length; ++i) {
    const Linearization& linearization = linearizations[i];
    const double radius = linearization.uv.norm();
    const size_t camera_idx = track.observations[i].camera_idx;
    const CameraState& state = states[camera_idx];
    if (radius <= state.max_radius) continue;
    const Eigen::Vector2d xy =
        linearization.residual + track.observations[i].xy;
    Eigen::Vector2d uv;
    scene_->cameras[camera_idx].model->Unproject(
        state.params.data(), xy.x(), xy.y(), uv.data());
    if (!((uv - linearization.uv).norm() <= kMaxDifference * radius)) {
      return true;
    }
  }
  return false;
}

bool TrackSolver::HasOutlier(const Track& track,
                             const std::vector<CameraState>& states,
                             const Eigen::Vector3d& xyz) const {
  double rho_at_zero[3];
  losses_.keypoints->Evaluate(0.0, rho_at_zero);
  for (size_t i = 0; i < track.length; ++i) {
    const Track::Observation& observation = track.observations[i];
    const size_t camera_idx = observation.camera_idx;
    Eigen::Vector2d xy;
    if (!ProjectPoint(
            *scene_->cameras[camera_idx].model, states[camera_idx], xyz, &xy)) {
      return true;
    }
    double rho[3];
    losses_.keypoints->Evaluate((xy - observation.xy).squaredNorm(), rho);
    if (rho[1] < 0.5 * rho_at_zero[1]) return true;
  }
  return false;
}

std::vector<Ray> TrackSolver::Rays(
    const Track& track, const std::vector<CameraState>& states) const {
  std::vector<Ray> rays;
  for (size_t i = 0; i < track.length; ++i) {
    const Track::Observation& observation = track.observations[i];
    Ray ray;
    if (UnprojectRay(*scene_->cameras[observation.camera_idx].model,
                     states[observation.camera_idx],
                     observation.xy,
                     &ray)) {
      rays.push_back(ray);
    }
  }
  return rays;
}

TrackSolver::Minimum TrackSolver::FindLowestMinimum(
    const Track& track,
    const std::vector<CameraState>& states,
    const Minimum& minimum,
    Eigen::Vector3d* xyz) const {
  if (minimum.converged && !HasOutlier(track, states, *xyz)) return minimum;
  std::vector<std::pair<double, Eigen::Vector3d>> starts;
  for (const Eigen::Vector3d& start : RayIntersections(Rays(track, states))) {
    starts.emplace_back(Cost(track, states, start), start);
  }
  const size_t num_starts = std::min(starts.size(), kMaxNumStarts);
  std::partial_sort(
      starts.begin(),
      starts.begin() + static_cast<std::ptrdiff_t>(num_starts),
      starts.end(),
      [](const auto& a, const auto& b) { return a.first < b.first; });
  Minimum lowest = minimum;
  for (size_t i = 0; i < num_starts; ++i) {
    const Minimum other = Minimize(track, states, &starts[i].second);
    // The same minimum again, up to rounding, is no lower one. Any is better
    // than none.
    if (other.converged &&
        (!lowest.converged || other.cost < lowest.cost * (1.0 - 1e-9))) {
      lowest = other;
      *xyz = starts[i].second;
    }
  }
  return lowest;
}

}  // namespace mfir
