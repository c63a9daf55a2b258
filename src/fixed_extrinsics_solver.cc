#include "fixed_extrinsics_solver.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <optional>

#include <Eigen/Cholesky>
#include <Eigen/Dense>
#include <Eigen/Eigenvalues>

#include "free_params.h"
#include "linearization.h"
#include "normal_equations.h"
#include "parallel_for.h"
#include "track_solver.h"

namespace mfir {
namespace {

constexpr size_t kTracksPerChunk = 256;
constexpr size_t kMaxChunkBytes = size_t{512} << 20;
// Damping as a factor on the diagonal of the normal equations; below the
// smallest value it is off.
constexpr double kInitialDamping = 1e-4;
constexpr double kMaxDamping = 1e12;
// What holds a direction, relative to the largest information.
constexpr double kHoldingFactor = 1e6;

using ParamsBlock =
    Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::ColMajor, kMaxNumParams, 3>;
using ParamsBlocks =
    std::vector<ParamsBlock, Eigen::aligned_allocator<ParamsBlock>>;

Track::Observation MakeTrackObservation(const Frame& frame,
                                        const Observation& observation) {
  Track::Observation result = {frame.images[observation.image_idx].camera_idx,
                               observation.xy};
  if (observation.cost_map_idx >= 0) {
    result.cost_maps = frame.cost_maps.get();
    result.cost_map_idx = static_cast<size_t>(observation.cost_map_idx);
    if (!frame.feature_keypoints.empty()) {
      result.feature = &frame.feature_keypoints[result.cost_map_idx];
    }
  }
  return result;
}

class Solver {
 public:
  Solver(const FixedExtrinsicsOptions& options, Scene* scene);

  FixedExtrinsicsSummary Solve();

 private:
  using States = std::vector<CameraState>;
  using Points = std::vector<Eigen::Vector3d>;

  void CollectTracks();
  void CollectParams();

  // Adds one track, its point eliminated; stores what back-substitution needs.
  void EliminateTrack(size_t track_idx,
                      Curvature curvature,
                      NormalEquations* equations);
  NormalEquations BuildNormalEquations(Curvature curvature, bool with_outer);

  double PriorCost(const States& states) const;
  void AddPriors(bool with_outer, NormalEquations* equations) const;
  // Finds the directions that min_information holds.
  void FindHeldDirections();

  // Cost after the step. Each point takes its own step or stays, whichever is
  // better, and moves on to its minimum: what is left to minimize is a function
  // of the cameras alone.
  double TryStep(const Eigen::VectorXd& step,
                 const States& new_states,
                 Points* new_points) const;
  States AddStep(const Eigen::VectorXd& step) const;
  void SetPoints(const Points& points);
  // Moves points to lower minima: whether any moved.
  bool ImprovePoints(double* cost);
  // Steps until convergence or the largest number of iterations.
  void Iterate(double* cost, FixedExtrinsicsSummary* summary);
  void SetCameras();
  bool IsSmall(const Eigen::VectorXd& step, double* focal_change) const;
  Eigen::MatrixXd Covariance();

  template <typename Function>
  void ParallelForChunks(const Function& function) const;

  const FixedExtrinsicsOptions options_;
  Scene* scene_;
  std::vector<Track::Observation> observations_;
  std::vector<Track> tracks_;
  size_t chunk_size_ = 0;
  size_t num_chunks_ = 0;

  // By camera: what is free, and where it starts in the reduced system.
  std::vector<FreeParams> free_params_;
  std::vector<Eigen::Index> offsets_;
  std::vector<FreeParam> params_;
  Eigen::Index num_params_ = 0;
  // Columns: held directions, in pixels.
  Eigen::MatrixXd held_directions_;
  double holding_information_ = 0.0;

  std::optional<TrackSolver> track_solver_;
  States states_;
  // Back-substitution: step_xyz = -(point_steps + sum_obs back_blocks^T step).
  Points point_steps_;
  ParamsBlocks back_blocks_;
};

Solver::Solver(const FixedExtrinsicsOptions& options, Scene* scene)
    : options_(options), scene_(scene), states_(CameraStates(*scene)) {
  if (options_.improve_points) MovePointsToTheFront(states_, scene_);
  CollectTracks();
  CollectParams();
  track_solver_.emplace(
      TrackLosses{options_.loss, options_.feature_loss, options_.cost_map_loss},
      scene_,
      free_params_);

  // A fixed partition (independent of the number of threads) whose partial sums
  // are added in order makes the result reproducible.
  const size_t bytes_per_chunk =
      2 * sizeof(double) * static_cast<size_t>(num_params_ * num_params_) + 1;
  const size_t max_num_chunks =
      std::max<size_t>(2, kMaxChunkBytes / bytes_per_chunk);
  chunk_size_ = std::max(
      kTracksPerChunk, (tracks_.size() + max_num_chunks - 1) / max_num_chunks);
  num_chunks_ = (tracks_.size() + chunk_size_ - 1) / chunk_size_;

  point_steps_.assign(tracks_.size(), Eigen::Vector3d::Zero());
  back_blocks_.resize(observations_.size());
  for (size_t i = 0; i < observations_.size(); ++i) {
    back_blocks_[i].setZero(
        static_cast<Eigen::Index>(
            free_params_[observations_[i].camera_idx].Size()),
        3);
  }
  if (options_.min_information > 0.0 && num_params_ > 0) FindHeldDirections();
}

void Solver::CollectTracks() {
  const std::vector<double> squared_residuals =
      SquaredResiduals(*scene_, options_.num_threads);
  size_t k = 0;
  for (size_t i = 0; i < scene_->frames.size(); ++i) {
    Frame& frame = scene_->frames[i];
    for (size_t j = 0; j < frame.points.size(); ++j) {
      const size_t begin = observations_.size();
      for (size_t m = frame.track_begins[j]; m < frame.track_begins[j + 1];
           ++m) {
        const Observation& observation = frame.observations[m];
        if (std::isfinite(squared_residuals[k++])) {
          observations_.push_back(MakeTrackObservation(frame, observation));
        }
      }
      if (observations_.size() - begin < 2) {
        observations_.resize(begin);
        continue;
      }
      Track track;
      track.xyz = &frame.points[j];
      track.weight =
          options_.frame_weights.empty() ? 1.0 : options_.frame_weights[i];
      track.length = observations_.size() - begin;
      tracks_.push_back(track);
    }
  }
  const Track::Observation* observations = observations_.data();
  for (Track& track : tracks_) {
    track.observations = observations;
    observations += track.length;
  }
}

void Solver::CollectParams() {
  std::vector<bool> observed(scene_->cameras.size(), false);
  for (const Track::Observation& observation : observations_) {
    observed[observation.camera_idx] = true;
  }
  for (size_t i = 0; i < scene_->cameras.size(); ++i) {
    offsets_.push_back(static_cast<Eigen::Index>(params_.size()));
    const std::vector<FreeParam> camera_params =
        observed[i] ? FreeParamsOfCamera(options_, *scene_, i)
                    : std::vector<FreeParam>();
    free_params_.push_back(ToFreeParams(camera_params));
    params_.insert(params_.end(), camera_params.begin(), camera_params.end());
  }
  num_params_ = static_cast<Eigen::Index>(params_.size());
}

template <typename Function>
void Solver::ParallelForChunks(const Function& function) const {
  ParallelFor(num_chunks_, options_.num_threads, [&](size_t chunk) {
    const size_t begin = chunk * chunk_size_;
    function(chunk, begin, std::min(tracks_.size(), begin + chunk_size_));
  });
}

void Solver::EliminateTrack(size_t track_idx,
                            Curvature curvature,
                            NormalEquations* equations) {
  thread_local std::vector<Linearization> linearizations;
  thread_local TrackSystem system;
  thread_local ParamsBlocks blocks;
  const Track& track = tracks_[track_idx];
  const TrackSolver& track_solver = *track_solver_;
  track_solver.Linearize(track, states_, *track.xyz, &linearizations);
  track_solver.BuildSystem(track, linearizations, curvature, 0.0, &system);

  point_steps_[track_idx] = system.hessian.solve(system.gradient);
  ParamsBlock* back_blocks = &back_blocks_[static_cast<size_t>(
      track.observations - observations_.data())];
  blocks.resize(track.length);
  for (size_t i = 0; i < track.length; ++i) {
    blocks[i] = linearizations[i].jacobian_params.transpose() *
                system.observations[i].weight *
                linearizations[i].jacobian_point;
    back_blocks[i] = system.hessian.solve(blocks[i].transpose()).transpose();
  }
  for (size_t i = 0; i < track.length; ++i) {
    const auto& jacobian = linearizations[i].jacobian_params;
    const Eigen::Index offset = offsets_[track.observations[i].camera_idx];
    const Eigen::Index size = jacobian.cols();
    if (size == 0) continue;
    const Eigen::VectorXd gradient =
        jacobian.transpose() * system.observations[i].weighted_residual;
    equations->hessian.block(offset, offset, size, size) +=
        jacobian.transpose() * system.observations[i].weight * jacobian;
    equations->gradient.segment(offset, size) +=
        gradient - blocks[i] * point_steps_[track_idx];
    for (size_t j = 0; j < track.length; ++j) {
      const auto& other_jacobian = linearizations[j].jacobian_params;
      const Eigen::Index other_offset =
          offsets_[track.observations[j].camera_idx];
      const Eigen::Index other_size = other_jacobian.cols();
      if (other_offset > offset || other_size == 0) continue;
      equations->hessian.block(offset, other_offset, size, other_size) -=
          back_blocks[i] * blocks[j].transpose();
      if (equations->gradient_outer.size() > 0) {
        equations->gradient_outer.block(
            offset, other_offset, size, other_size) +=
            gradient * (system.observations[j].weighted_residual.transpose() *
                        other_jacobian);
      }
    }
  }
}

NormalEquations Solver::BuildNormalEquations(Curvature curvature,
                                             bool with_outer) {
  std::vector<NormalEquations> chunks(num_chunks_);
  ParallelForChunks([&](size_t chunk, size_t begin, size_t end) {
    chunks[chunk].SetZero(num_params_, with_outer);
    for (size_t i = begin; i < end; ++i) {
      EliminateTrack(i, curvature, &chunks[chunk]);
    }
  });
  NormalEquations sum;
  sum.SetZero(num_params_, with_outer);
  for (const NormalEquations& chunk : chunks) {
    sum.hessian += chunk.hessian;
    sum.gradient += chunk.gradient;
    if (with_outer) sum.gradient_outer += chunk.gradient_outer;
  }
  AddPriors(with_outer, &sum);
  return sum;
}

double Solver::PriorCost(const States& states) const {
  return 0.5 * options_.prior_weight *
         PriorResiduals(params_, *scene_, states).squaredNorm();
}

void Solver::AddPriors(bool with_outer, NormalEquations* equations) const {
  const Eigen::VectorXd residuals = PriorResiduals(params_, *scene_, states_);
  for (Eigen::Index i = 0; i < num_params_; ++i) {
    const double std = params_[i].prior_std;
    if (std == 0.0) continue;
    const double information = options_.prior_weight / (std * std);
    equations->hessian(i, i) += information;
    equations->gradient(i) += options_.prior_weight * residuals(i) / std;
    if (with_outer) {
      equations->gradient_outer(i, i) += options_.prior_weight * information;
    }
  }
  if (held_directions_.cols() == 0) return;
  Eigen::MatrixXd directions = held_directions_;
  for (Eigen::Index i = 0; i < num_params_; ++i) {
    directions.row(i) *= params_[i].pixels;
  }
  const Eigen::MatrixXd holding =
      holding_information_ * directions * directions.transpose();
  equations->hessian += holding;
  if (with_outer) {
    equations->gradient_outer += options_.prior_weight * holding;
  }
}

void Solver::FindHeldDirections() {
  Eigen::MatrixXd information =
      BuildNormalEquations(Curvature::kReweighted, false)
          .hessian.selfadjointView<Eigen::Lower>();
  for (Eigen::Index i = 0; i < num_params_; ++i) {
    information.row(i) /= params_[i].pixels;
    information.col(i) /= params_[i].pixels;
  }
  const double min_information =
      options_.min_information * options_.prior_weight;
  const Eigen::MatrixXd rest =
      information -
      min_information * Eigen::MatrixXd::Identity(num_params_, num_params_);
  if (Eigen::LLT<Eigen::MatrixXd>(rest).info() == Eigen::Success) return;
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(information);
  Eigen::Index num_held = 0;
  while (num_held < num_params_ &&
         eigen.eigenvalues()(num_held) < min_information) {
    ++num_held;
  }
  held_directions_ = eigen.eigenvectors().leftCols(num_held);
  holding_information_ = kHoldingFactor * information.diagonal().maxCoeff();
}

Solver::States Solver::AddStep(const Eigen::VectorXd& step) const {
  States states = states_;
  for (size_t i = 0; i < states.size(); ++i) {
    CameraState& state = states[i];
    Eigen::Index k = offsets_[i];
    for (const size_t idx : free_params_[i].intrinsics_idxs) {
      state.params[idx] += step(k++);
    }
    if (free_params_[i].pose) {
      MovePose(step.segment<3>(k), step.segment<3>(k + 3), &state);
    }
  }
  return states;
}

double Solver::TryStep(const Eigen::VectorXd& step,
                       const States& new_states,
                       Points* new_points) const {
  for (const FreeParam& param : params_) {
    if (param.type != FreeParam::kFocalLength) continue;
    // A focal length that more than halves or doubles has left the region in
    // which the linearization means anything.
    const double ratio = new_states[param.camera_idx].params[param.idx] /
                         states_[param.camera_idx].params[param.idx];
    if (!(ratio > 0.5 && ratio < 2.0)) {
      return std::numeric_limits<double>::infinity();
    }
  }
  const TrackSolver& track_solver = *track_solver_;
  std::vector<double> costs(num_chunks_, 0.0);
  ParallelForChunks([&](size_t chunk, size_t begin, size_t end) {
    for (size_t i = begin; i < end; ++i) {
      const Track& track = tracks_[i];
      const size_t first =
          static_cast<size_t>(track.observations - observations_.data());
      Eigen::Vector3d& xyz = (*new_points)[i];
      xyz = *track.xyz - point_steps_[i];
      for (size_t k = 0; k < track.length; ++k) {
        const size_t camera_idx = track.observations[k].camera_idx;
        const ParamsBlock& block = back_blocks_[first + k];
        xyz -= block.transpose() *
               step.segment(offsets_[camera_idx], block.rows());
      }
      if (!(track_solver.Cost(track, new_states, xyz) <=
            track_solver.Cost(track, new_states, *track.xyz))) {
        xyz = *track.xyz;
      }
      costs[chunk] += track_solver.Minimize(track, new_states, &xyz);
    }
  });
  double cost = PriorCost(new_states);
  for (const double chunk_cost : costs) cost += chunk_cost;
  return std::isnan(cost) ? std::numeric_limits<double>::infinity() : cost;
}

void Solver::SetPoints(const Points& points) {
  for (size_t i = 0; i < tracks_.size(); ++i) {
    *tracks_[i].xyz = points[i];
  }
}

bool Solver::ImprovePoints(double* cost) {
  if (!options_.improve_points) return false;
  std::vector<double> costs(num_chunks_, 0.0);
  std::vector<size_t> num_moved(num_chunks_, 0);
  ParallelForChunks([&](size_t chunk, size_t begin, size_t end) {
    for (size_t i = begin; i < end; ++i) {
      const Track& track = tracks_[i];
      num_moved[chunk] +=
          track_solver_->FindLowerMinimum(track, states_, track.xyz);
      costs[chunk] += track_solver_->Cost(track, states_, *track.xyz);
    }
  });
  if (std::accumulate(num_moved.begin(), num_moved.end(), size_t{0}) == 0) {
    return false;
  }
  *cost = std::accumulate(costs.begin(), costs.end(), PriorCost(states_));
  return true;
}

void Solver::SetCameras() {
  for (size_t i = 0; i < scene_->cameras.size(); ++i) {
    RigCamera& camera = scene_->cameras[i];
    camera.params = states_[i].params;
    if (free_params_[i].pose) {
      camera.cam_from_world.rotation = Eigen::Quaterniond(states_[i].rotation);
      camera.cam_from_world.translation = states_[i].translation;
    }
  }
}

bool Solver::IsSmall(const Eigen::VectorXd& step, double* focal_change) const {
  double max_change = 0.0;
  *focal_change = 0.0;
  for (Eigen::Index i = 0; i < num_params_; ++i) {
    const FreeParam& param = params_[i];
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
  Eigen::MatrixXd free_covariance;
  if (!SandwichCovariance(BuildNormalEquations(Curvature::kNewton, true),
                          &free_covariance) &&
      !SandwichCovariance(BuildNormalEquations(Curvature::kReweighted, true),
                          &free_covariance)) {
    free_covariance.setConstant(
        num_params_, num_params_, std::numeric_limits<double>::quiet_NaN());
  }
  return IntrinsicsCovariance(params_, *scene_, free_covariance);
}

void Solver::Iterate(double* cost, FixedExtrinsicsSummary* summary) {
  Points new_points(tracks_.size());
  double damping = 0.0;
  Curvature curvature = Curvature::kNewton;
  bool tried_undamped = false;
  while (!summary->converged &&
         summary->num_iterations < options_.max_num_iterations) {
    ++summary->num_iterations;
    const NormalEquations equations = BuildNormalEquations(curvature, false);
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
    const States new_states = AddStep(step);
    const double new_cost = TryStep(step, new_states, &new_points);
    const bool small_step = IsSmall(step, &summary->last_focal_change);
    // Rounding limits what the cost can resolve.
    if (new_cost <= *cost * (1.0 + 1e-13)) {
      summary->converged = small_step && damping < kMinDamping;
      states_ = new_states;
      SetPoints(new_points);
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
  Points new_points(tracks_.size());
  // A step of zero: the points move to their minima.
  std::fill(point_steps_.begin(), point_steps_.end(), Eigen::Vector3d::Zero());
  double cost =
      TryStep(Eigen::VectorXd::Zero(num_params_), states_, &new_points);
  SetPoints(new_points);
  ImprovePoints(&cost);
  summary.initial_cost = cost;
  do {
    summary.converged = num_params_ == 0;
    Iterate(&cost, &summary);
  } while (summary.num_iterations < options_.max_num_iterations &&
           ImprovePoints(&cost));
  SetCameras();
  summary.final_cost = cost;
  for (const Track& track : tracks_) {
    summary.final_feature_cost +=
        track_solver_->FeatureCost(track, states_, *track.xyz);
  }
  summary.held_cameras.assign(scene_->cameras.size(), false);
  for (Eigen::Index i = 0; i < num_params_; ++i) {
    if (held_directions_.cols() > 0 &&
        held_directions_.row(i).squaredNorm() > 0.1) {
      summary.held_cameras[params_[i].camera_idx] = true;
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
