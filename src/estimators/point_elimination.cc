#include "src/estimators/point_elimination.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>

#include <Eigen/Dense>

#include "src/parallel/parallel_for.h"
#include "src/residuals/noise_samples.h"

namespace mfir {
namespace {

// A point whose minimum vanishes moves to another one, which costs more. Where
// the cameras then go back to where it vanishes, the solve would go round in
// circles.
constexpr int kMaxNumRescues = 3;

constexpr size_t kTracksPerChunk = 256;
constexpr size_t kMaxChunkBytes = size_t{512} << 20;

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

size_t CountFinite(const double* begin, const double* end) {
  return static_cast<size_t>(std::count_if(
      begin, end, [](double value) { return std::isfinite(value); }));
}

}  // namespace

PointElimination::PointElimination(const FixedExtrinsicsOptions& options,
                                   const States& states,
                                   const Scene& scene,
                                   Estimate* estimate)
    : options_(options), scene_(scene) {
  if (options_.improve_points) {
    MovePointsToTheFront(states, scene_, options_.num_threads, estimate);
  }
  CollectTracks(estimate);
  params_ = CollectFreeParams(options_, scene_, *estimate, ObservedCameras());
  track_solver_.emplace(
      TrackLosses{options_.loss, options_.feature_loss, options_.cost_map_loss},
      &scene_,
      params_.by_camera);
  PartitionTracks();
  left_out_.assign(tracks_.size(), 0);
  num_rescues_.assign(tracks_.size(), 0);
  point_steps_.resize(tracks_.size());
  AllocateBackBlocks();
}

// Frames side by side: first the counts, which say where each has its place.
void PointElimination::CollectTracks(Estimate* estimate) {
  const std::vector<double> squared_residuals =
      SquaredResiduals(scene_, *estimate, options_.num_threads);
  const size_t num_frames = scene_.frames.size();
  std::vector<size_t> residual_begins = {0};
  for (const Frame& frame : scene_.frames) {
    residual_begins.push_back(residual_begins.back() +
                              frame.observations.size());
  }
  std::vector<FrameCounts> counts(num_frames);
  ParallelFor(num_frames, options_.num_threads, [&](size_t f) {
    const Frame& frame = scene_.frames[f];
    const double* squared = squared_residuals.data() + residual_begins[f];
    for (size_t j = 0; j < frame.NumPoints(); ++j) {
      const size_t count = CountFinite(squared + frame.track_begins[j],
                                       squared + frame.track_begins[j + 1]);
      if (count < 2) continue;
      counts[f].num_observations += count;
      ++counts[f].num_tracks;
    }
  });
  std::vector<FrameCounts> begins(1);
  for (const FrameCounts& count : counts) {
    begins.push_back({begins.back().num_observations + count.num_observations,
                      begins.back().num_tracks + count.num_tracks});
  }
  observations_.resize(begins.back().num_observations);
  tracks_.resize(begins.back().num_tracks);
  track_idxs_.resize(begins.back().num_tracks);
  ParallelFor(num_frames, options_.num_threads, [&](size_t f) {
    CollectTracksOfFrame(
        f, squared_residuals.data() + residual_begins[f], begins[f], estimate);
  });
}

void PointElimination::CollectTracksOfFrame(size_t frame_idx,
                                            const double* squared_residuals,
                                            const FrameCounts& begin,
                                            Estimate* estimate) {
  const Frame& frame = scene_.frames[frame_idx];
  size_t next_observation = begin.num_observations;
  size_t next_track = begin.num_tracks;
  for (size_t j = 0; j < frame.NumPoints(); ++j) {
    const size_t first = frame.track_begins[j];
    const size_t last = frame.track_begins[j + 1];
    if (CountFinite(squared_residuals + first, squared_residuals + last) < 2) {
      continue;
    }
    Track track;
    track.xyz = &estimate->frames[frame_idx].points[j];
    track.weight = options_.frame_weights.empty()
                       ? 1.0
                       : options_.frame_weights[frame_idx];
    track.observations = &observations_[next_observation];
    for (size_t k = first; k < last; ++k) {
      if (!std::isfinite(squared_residuals[k])) continue;
      observations_[next_observation++] =
          MakeTrackObservation(frame, frame.observations[k]);
      ++track.length;
    }
    tracks_[next_track] = track;
    track_idxs_[next_track++] = {frame_idx, j};
  }
}

std::vector<bool> PointElimination::ObservedCameras() const {
  std::vector<bool> observed(scene_.cameras.size(), false);
  for (const Track::Observation& observation : observations_) {
    observed[observation.camera_idx] = true;
  }
  return Any(*scene_.ranks, observed);
}

// Not initialized: the threads that fill it touch it first.
void PointElimination::AllocateBackBlocks() {
  size_t size = 0;
  back_block_begins_.reserve(tracks_.size());
  for (const Track& track : tracks_) {
    back_block_begins_.push_back(size);
    for (size_t i = 0; i < track.length; ++i) {
      size += 3 * static_cast<size_t>(
                      params_.SizeOf(track.observations[i].camera_idx));
    }
  }
  back_blocks_.reset(new double[size]);
}

// A fixed partition (independent of the number of threads) whose partial sums
// are added in order makes the result reproducible.
void PointElimination::PartitionTracks() {
  const size_t bytes_per_chunk =
      2 * sizeof(double) *
          static_cast<size_t>(params_.Size() * params_.Size()) +
      1;
  const size_t max_num_chunks =
      std::max<size_t>(2, kMaxChunkBytes / bytes_per_chunk);
  chunk_size_ = std::max(
      kTracksPerChunk, (tracks_.size() + max_num_chunks - 1) / max_num_chunks);
}

template <typename Function>
void PointElimination::ParallelForChunks(size_t count,
                                         const Function& function) const {
  ParallelFor(NumChunks(count), options_.num_threads, [&](size_t chunk) {
    const size_t begin = chunk * chunk_size_;
    function(chunk, begin, std::min(count, begin + chunk_size_));
  });
}

void PointElimination::EliminateTrack(size_t track_idx,
                                      const States& states,
                                      Curvature curvature,
                                      double min_share,
                                      NormalEquations* equations) {
  thread_local std::vector<Linearization> linearizations;
  thread_local TrackSystem system;
  thread_local ParamsBlocks blocks;
  const Track& track = tracks_[track_idx];
  const TrackSolver& track_solver = *track_solver_;
  track_solver.Linearize(track, states, *track.xyz, &linearizations);
  track_solver.BuildSystem(
      track, linearizations, curvature, min_share, 0.0, &system);

  point_steps_[track_idx] = system.hessian.solve(system.gradient);
  thread_local ParamsBlocks back_blocks;
  double* stored = &back_blocks_[back_block_begins_[track_idx]];
  blocks.resize(track.length);
  back_blocks.resize(track.length);
  for (size_t i = 0; i < track.length; ++i) {
    blocks[i] = linearizations[i].jacobian_params.transpose() *
                system.observations[i].weight *
                linearizations[i].jacobian_point;
    back_blocks[i] = system.hessian.solve(blocks[i].transpose()).transpose();
    stored = std::copy_n(back_blocks[i].data(), back_blocks[i].size(), stored);
  }
  for (size_t i = 0; i < track.length; ++i) {
    const auto& jacobian = linearizations[i].jacobian_params;
    const Eigen::Index offset =
        params_.offsets[track.observations[i].camera_idx];
    const Eigen::Index size = jacobian.cols();
    if (size == 0) continue;
    const Eigen::VectorXd gradient =
        jacobian.transpose() * system.observations[i].weighted_residual;
    equations->hessian.block(offset, offset, size, size) +=
        jacobian.transpose() * system.observations[i].weight * jacobian;
    equations->gradient.segment(offset, size) +=
        gradient - blocks[i] * point_steps_[track_idx];
    for (size_t j = 0; j < track.length; ++j) {
      const Eigen::Index other_offset =
          params_.offsets[track.observations[j].camera_idx];
      const Eigen::Index other_size = linearizations[j].jacobian_params.cols();
      if (other_offset > offset || other_size == 0) continue;
      equations->hessian.block(offset, other_offset, size, other_size) -=
          back_blocks[i] * blocks[j].transpose();
    }
  }
}

NormalEquations PointElimination::BuildNormalEquations(const States& states,
                                                       Curvature curvature,
                                                       double min_share) {
  std::vector<NormalEquations> chunks(NumChunks(tracks_.size()));
  ParallelForChunks(
      tracks_.size(), [&](size_t chunk, size_t begin, size_t end) {
        chunks[chunk].SetZero(params_.Size());
        for (size_t i = begin; i < end; ++i) {
          if (left_out_[i]) continue;
          EliminateTrack(i, states, curvature, min_share, &chunks[chunk]);
        }
      });
  NormalEquations sum;
  sum.SetZero(params_.Size());
  ParallelFor(static_cast<size_t>(params_.Size()),
              options_.num_threads,
              [&](size_t column) {
                for (const NormalEquations& chunk : chunks) {
                  sum.hessian.col(column) += chunk.hessian.col(column);
                }
              });
  for (const NormalEquations& chunk : chunks) sum.gradient += chunk.gradient;
  scene_.ranks->Sum(sum.hessian.data(), sum.hessian.size());
  scene_.ranks->Sum(sum.gradient.data(), sum.gradient.size());
  return sum;
}

void PointElimination::AddGradient(size_t track_idx,
                                   const States& states,
                                   Eigen::VectorXd* gradient,
                                   std::vector<size_t>* camera_idxs) const {
  thread_local std::vector<Linearization> linearizations;
  thread_local TrackSystem system;
  const Track& track = tracks_[track_idx];
  const TrackSolver& track_solver = *track_solver_;
  track_solver.Linearize(track, states, *track.xyz, &linearizations);
  track_solver.BuildSystem(
      track, linearizations, Curvature::kReweighted, 0.0, 0.0, &system);
  for (size_t i = 0; i < track.length; ++i) {
    const size_t camera_idx = track.observations[i].camera_idx;
    const auto& jacobian = linearizations[i].jacobian_params;
    gradient->segment(params_.offsets[camera_idx], jacobian.cols()) +=
        jacobian.transpose() * system.observations[i].weighted_residual;
    camera_idxs->push_back(camera_idx);
  }
}

std::vector<std::vector<size_t>> PointElimination::GroupTracks() const {
  std::vector<std::vector<size_t>> groups;
  std::vector<bool> is_repeated(tracks_.size(), false);
  for (const std::vector<TrackIndex>& repeated : options_.repeated_tracks) {
    std::vector<size_t> group;
    for (const TrackIndex& track : repeated) {
      const auto found =
          std::lower_bound(track_idxs_.begin(), track_idxs_.end(), track);
      // Not all tracks of the scene take part.
      if (found == track_idxs_.end() || track < *found) continue;
      group.push_back(static_cast<size_t>(found - track_idxs_.begin()));
      is_repeated[group.back()] = true;
    }
    groups.push_back(std::move(group));
  }
  for (size_t i = 0; i < tracks_.size(); ++i) {
    if (!is_repeated[i]) groups.push_back({i});
  }
  return groups;
}

void PointElimination::AddOuter(const std::vector<size_t>& camera_idxs,
                                const Eigen::VectorXd& gradient,
                                Eigen::MatrixXd* outer) const {
  for (size_t a = 0; a < camera_idxs.size(); ++a) {
    const Eigen::Index offset = params_.offsets[camera_idxs[a]];
    const Eigen::Index size = params_.SizeOf(camera_idxs[a]);
    for (size_t b = 0; b <= a; ++b) {
      const Eigen::Index other_offset = params_.offsets[camera_idxs[b]];
      const Eigen::Index other_size = params_.SizeOf(camera_idxs[b]);
      outer->block(offset, other_offset, size, other_size) +=
          gradient.segment(offset, size) *
          gradient.segment(other_offset, other_size).transpose();
    }
  }
}

void PointElimination::AddGroupGradient(
    const std::vector<size_t>& group,
    const States& states,
    Eigen::VectorXd* gradient,
    std::vector<size_t>* camera_idxs) const {
  for (const size_t track_idx : group) {
    if (left_out_[track_idx]) continue;
    AddGradient(track_idx, states, gradient, camera_idxs);
  }
  std::sort(camera_idxs->begin(), camera_idxs->end());
  camera_idxs->erase(std::unique(camera_idxs->begin(), camera_idxs->end()),
                     camera_idxs->end());
}

// The gradients of some groups at a time, summed over the ranks.
void PointElimination::AddSharedOuters(
    const std::vector<std::vector<size_t>>& groups,
    const States& states,
    Eigen::MatrixXd* outer) const {
  constexpr size_t kGroupsAtOnce = 1024;
  const Communicator& ranks = *scene_.ranks;
  std::vector<size_t> camera_idxs;
  for (size_t begin = 0; begin < groups.size(); begin += kGroupsAtOnce) {
    const size_t num = std::min(kGroupsAtOnce, groups.size() - begin);
    Eigen::MatrixXd gradients =
        Eigen::MatrixXd::Zero(params_.Size(), static_cast<Eigen::Index>(num));
    for (size_t i = 0; i < num; ++i) {
      Eigen::VectorXd gradient = Eigen::VectorXd::Zero(params_.Size());
      camera_idxs.clear();
      AddGroupGradient(groups[begin + i], states, &gradient, &camera_idxs);
      gradients.col(static_cast<Eigen::Index>(i)) = gradient;
    }
    ranks.Sum(gradients.data(), static_cast<size_t>(gradients.size()));
    if (!ranks.IsFirst()) continue;
    outer->selfadjointView<Eigen::Lower>().rankUpdate(gradients);
  }
}

Eigen::MatrixXd PointElimination::GradientOuter(const States& states) const {
  std::vector<std::vector<size_t>> groups = GroupTracks();
  const Eigen::Index num_params = params_.Size();
  std::vector<std::vector<size_t>> shared_groups;
  if (!scene_.ranks->IsAlone()) {
    const auto end = groups.begin() + static_cast<std::ptrdiff_t>(
                                          options_.repeated_tracks.size());
    shared_groups.assign(groups.begin(), end);
    groups.erase(groups.begin(), end);
  }
  std::vector<Eigen::MatrixXd> chunks(NumChunks(groups.size()));
  ParallelForChunks(groups.size(), [&](size_t chunk, size_t begin, size_t end) {
    Eigen::MatrixXd& outer = chunks[chunk];
    outer.setZero(num_params, num_params);
    Eigen::VectorXd gradient = Eigen::VectorXd::Zero(num_params);
    std::vector<size_t> camera_idxs;
    for (size_t i = begin; i < end; ++i) {
      camera_idxs.clear();
      AddGroupGradient(groups[i], states, &gradient, &camera_idxs);
      AddOuter(camera_idxs, gradient, &outer);
      gradient.setZero();
    }
  });
  Eigen::MatrixXd sum = Eigen::MatrixXd::Zero(num_params, num_params);
  for (const Eigen::MatrixXd& chunk : chunks) sum += chunk;
  AddSharedOuters(shared_groups, states, &sum);
  scene_.ranks->Sum(sum.data(), static_cast<size_t>(sum.size()));
  return sum;
}

double PointElimination::StepTrack(size_t track_idx,
                                   const Eigen::VectorXd& step,
                                   const States& new_states,
                                   Eigen::Vector3d* xyz) const {
  const Track& track = tracks_[track_idx];
  *xyz = *track.xyz - point_steps_[track_idx];
  const double* stored = &back_blocks_[back_block_begins_[track_idx]];
  for (size_t k = 0; k < track.length; ++k) {
    const size_t camera_idx = track.observations[k].camera_idx;
    const Eigen::Map<const ParamsBlock> block(
        stored, params_.SizeOf(camera_idx), 3);
    stored += block.size();
    *xyz -= block.transpose() *
            step.segment(params_.offsets[camera_idx], block.rows());
  }
  if (!(track_solver_->Cost(track, new_states, *xyz) <=
        track_solver_->Cost(track, new_states, *track.xyz))) {
    *xyz = *track.xyz;
  }
  return track_solver_->Minimize(track, new_states, xyz).cost;
}

double PointElimination::TryStep(const Eigen::VectorXd& step,
                                 const States& new_states,
                                 Points* new_points) const {
  new_points->resize(tracks_.size());
  std::vector<double> costs(NumChunks(tracks_.size()), 0.0);
  ParallelForChunks(tracks_.size(),
                    [&](size_t chunk, size_t begin, size_t end) {
                      for (size_t i = begin; i < end; ++i) {
                        Eigen::Vector3d& xyz = (*new_points)[i];
                        xyz = *tracks_[i].xyz;
                        if (left_out_[i]) continue;
                        costs[chunk] += StepTrack(i, step, new_states, &xyz);
                      }
                    });
  return Sum(*scene_.ranks, std::accumulate(costs.begin(), costs.end(), 0.0));
}

double PointElimination::LeaveOutObstacle(const Eigen::VectorXd& step,
                                          const States& states,
                                          const States& states_ahead,
                                          const States& states_behind) {
  std::vector<double> jumps(tracks_.size(), 0.0);
  ParallelForChunks(tracks_.size(), [&](size_t, size_t begin, size_t end) {
    for (size_t i = begin; i < end; ++i) {
      if (left_out_[i]) continue;
      Eigen::Vector3d xyz;
      const double jump =
          StepTrack(i, step, states_ahead, &xyz) +
          StepTrack(i, -step, states_behind, &xyz) -
          2.0 * track_solver_->Cost(tracks_[i], states, *tracks_[i].xyz);
      jumps[i] = std::isnan(jump) ? std::numeric_limits<double>::infinity()
                                  : std::abs(jump);
    }
  });
  const auto largest = std::max_element(jumps.begin(), jumps.end());
  const std::vector<double> by_rank =
      Concatenate(*scene_.ranks,
                  std::vector<double>{largest == jumps.end() ? 0.0 : *largest});
  const auto rank =
      std::max_element(by_rank.begin(), by_rank.end()) - by_rank.begin();
  if (rank == scene_.ranks->Rank() && largest != jumps.end()) {
    left_out_[static_cast<size_t>(largest - jumps.begin())] = 1;
  }
  return MinimizePoints(states);
}

double PointElimination::MinimizePoints(const States& states) {
  std::vector<double> costs(NumChunks(tracks_.size()), 0.0);
  ParallelForChunks(
      tracks_.size(), [&](size_t chunk, size_t begin, size_t end) {
        for (size_t i = begin; i < end; ++i) {
          if (left_out_[i]) continue;
          const Track& track = tracks_[i];
          costs[chunk] +=
              track_solver_->Minimize(track, states, track.xyz).cost;
        }
      });
  return Sum(*scene_.ranks, std::accumulate(costs.begin(), costs.end(), 0.0));
}

size_t PointElimination::NumLeftOut() const {
  return Sum(*scene_.ranks,
             static_cast<size_t>(
                 std::count(left_out_.begin(), left_out_.end(), char{1})));
}

// Cost maps have kinks, at which no point is regular.
bool PointElimination::LeavesOut(const TrackSolver::Minimum& minimum) const {
  return !minimum.converged && options_.cost_map_loss == nullptr;
}

void PointElimination::SetPoints(const Points& points) {
  ParallelForChunks(tracks_.size(), [&](size_t, size_t begin, size_t end) {
    for (size_t i = begin; i < end; ++i) *tracks_[i].xyz = points[i];
  });
}

bool PointElimination::ImprovePoints(const States& states, double* cost) {
  std::vector<double> costs(NumChunks(tracks_.size()), 0.0);
  std::vector<size_t> num_changed(costs.size(), 0);
  ParallelForChunks(tracks_.size(),
                    [&](size_t chunk, size_t begin, size_t end) {
                      for (size_t i = begin; i < end; ++i) {
                        if (left_out_[i]) continue;
                        const Track& track = tracks_[i];
                        TrackSolver::Minimum minimum =
                            track_solver_->Minimize(track, states, track.xyz);
                        const bool had_none = LeavesOut(minimum);
                        if (options_.improve_points) {
                          const double cost_before = minimum.cost;
                          minimum = track_solver_->FindLowestMinimum(
                              track, states, minimum, track.xyz);
                          num_changed[chunk] += minimum.cost != cost_before;
                        }
                        if (LeavesOut(minimum) ||
                            (had_none && ++num_rescues_[i] > kMaxNumRescues)) {
                          left_out_[i] = 1;
                          ++num_changed[chunk];
                        } else {
                          costs[chunk] += minimum.cost;
                        }
                      }
                    });
  const size_t num =
      std::accumulate(num_changed.begin(), num_changed.end(), size_t{0});
  if (Sum(*scene_.ranks, num) == 0) return false;
  *cost = Sum(*scene_.ranks, std::accumulate(costs.begin(), costs.end(), 0.0));
  return true;
}

double PointElimination::FeatureCost(const States& states) const {
  if (options_.feature_loss == nullptr && options_.cost_map_loss == nullptr) {
    return 0.0;
  }
  std::vector<double> costs(tracks_.size(), 0.0);
  ParallelForChunks(tracks_.size(), [&](size_t, size_t begin, size_t end) {
    for (size_t i = begin; i < end; ++i) {
      if (left_out_[i]) continue;
      costs[i] =
          track_solver_->FeatureCost(tracks_[i], states, *tracks_[i].xyz);
    }
  });
  return Sum(*scene_.ranks, std::accumulate(costs.begin(), costs.end(), 0.0));
}

}  // namespace mfir
