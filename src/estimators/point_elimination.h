// The points of all tracks in the solve with (nearly) fixed extrinsics:
// eliminated from the normal equations, moved by what the cameras' step leaves
// them, kept at their minima.

#pragma once

#include <cstddef>
#include <memory>
#include <optional>
#include <vector>

#include <Eigen/Core>

#include "src/estimators/fixed_extrinsics_solver.h"
#include "src/estimators/free_params.h"
#include "src/estimators/normal_equations.h"
#include "src/estimators/track_solver.h"
#include "src/residuals/linearization.h"
#include "src/scene/estimate.h"
#include "src/scene/scene.h"

namespace mfir {

class PointElimination {
 public:
  using States = std::vector<CameraState>;
  using Points = std::vector<Eigen::Vector3d>;

  // Takes the tracks that take part from the scene. `states`: of the estimate's
  // cameras. Moves the points of `estimate`, nothing else. All must outlive
  // this.
  PointElimination(const FixedExtrinsicsOptions& options,
                   const States& states,
                   const Scene& scene,
                   Estimate* estimate);

  // Of the cameras that are observed.
  const ReducedParams& Params() const { return params_; }
  size_t NumTracks() const { return tracks_.size(); }

  // Of the cameras, without priors. `min_share`: see TrackSolver. Stores what
  // TryStep needs. Equations, costs and counts are those of all ranks.
  NormalEquations BuildNormalEquations(const States& states,
                                       Curvature curvature,
                                       double min_share);

  // Lower triangle of the sum of g g^T, with g the gradient by the free
  // parameters of a group of options.repeated_tracks (over ranks the same ones
  // on all, each with its own tracks) or of a track of its own.
  // Points must be at their minima.
  Eigen::MatrixXd GradientOuter(const States& states) const;

  // Moves the points to their minima; returns the cost. Leaves out the tracks
  // that have none, for good.
  double MinimizePoints(const States& states);
  size_t NumLeftOut() const;

  // Cost after the step that the last normal equations gave. Each point takes
  // its own step or stays, whichever is better, and moves on to its minimum:
  // what is left to minimize is a function of the cameras alone.
  double TryStep(const Eigen::VectorXd& step,
                 const States& new_states,
                 Points* new_points) const;
  void SetPoints(const Points& points);

  // Moves points to their lowest minima, where they have several, and leaves
  // out, for good, tracks that have none, or lose theirs again and again:
  // whether anything changed, and then the cost.
  bool ImprovePoints(const States& states, double* cost);

  // Leaves out, for good, the track in the way of a solve that stalls: of all
  // ranks the one whose cost is least smooth along the step that the last
  // normal equations gave, by its second difference. Returns the cost.
  double LeaveOutObstacle(const Eigen::VectorXd& step,
                          const States& states,
                          const States& states_ahead,
                          const States& states_behind);

  // The part of features and cost maps.
  double FeatureCost(const States& states) const;

 private:
  using ParamsBlock = Eigen::
      Matrix<double, Eigen::Dynamic, 3, Eigen::ColMajor, kMaxNumParams, 3>;
  using ParamsBlocks =
      std::vector<ParamsBlock, Eigen::aligned_allocator<ParamsBlock>>;
  // Observations that take part, and tracks with two or more of them.
  struct FrameCounts {
    size_t num_observations = 0;
    size_t num_tracks = 0;
  };

  bool LeavesOut(const TrackSolver::Minimum& minimum) const;

  // Cost of a track after the step, and its point: see TryStep.
  double StepTrack(size_t track_idx,
                   const Eigen::VectorXd& step,
                   const States& new_states,
                   Eigen::Vector3d* xyz) const;

  void CollectTracks(Estimate* estimate);
  // Those of one frame, from the given places on. `squared_residuals`: of its
  // observations.
  void CollectTracksOfFrame(size_t frame_idx,
                            const double* squared_residuals,
                            const FrameCounts& begin,
                            Estimate* estimate);
  // Whether any rank has observations of the camera.
  std::vector<bool> ObservedCameras() const;
  void PartitionTracks();
  void AllocateBackBlocks();

  // Adds one track, its point eliminated.
  void EliminateTrack(size_t track_idx,
                      const States& states,
                      Curvature curvature,
                      double min_share,
                      NormalEquations* equations);
  // Adds the gradient of a track, and the cameras that see it.
  void AddGradient(size_t track_idx,
                   const States& states,
                   Eigen::VectorXd* gradient,
                   std::vector<size_t>* camera_idxs) const;
  // Adds g g^T of a gradient that is zero in all other cameras (ascending).
  void AddOuter(const std::vector<size_t>& camera_idxs,
                const Eigen::VectorXd& gradient,
                Eigen::MatrixXd* outer) const;
  // Each track in one group.
  std::vector<std::vector<size_t>> GroupTracks() const;
  // Of a group: sum of its gradients, and the cameras that see it, ascending.
  void AddGroupGradient(const std::vector<size_t>& group,
                        const States& states,
                        Eigen::VectorXd* gradient,
                        std::vector<size_t>* camera_idxs) const;
  // Adds g g^T of groups that have tracks on several ranks, each on one rank.
  void AddSharedOuters(const std::vector<std::vector<size_t>>& groups,
                       const States& states,
                       Eigen::MatrixXd* outer) const;

  // Calls function(chunk, begin, end) for the chunks of `count` items.
  template <typename Function>
  void ParallelForChunks(size_t count, const Function& function) const;
  size_t NumChunks(size_t count) const {
    return (count + chunk_size_ - 1) / chunk_size_;
  }

  const FixedExtrinsicsOptions& options_;
  const Scene& scene_;
  std::vector<Track::Observation> observations_;
  std::vector<Track> tracks_;
  std::vector<TrackIndex> track_idxs_;  // in the scene, ascending
  // By track: without a regular minimum, its point has no derivatives by the
  // cameras. Such points run into a camera centre, or have no two observations
  // that fit, and tell nothing. (Not bool: threads write to it.)
  std::vector<char> left_out_;
  // By track: how often it has lost its minimum and got another, which costs
  // more.
  std::vector<char> num_rescues_;
  size_t chunk_size_ = 0;
  ReducedParams params_;
  std::optional<TrackSolver> track_solver_;
  // Back-substitution: step_xyz = -(point_steps + sum_obs back_blocks^T step).
  // The blocks (parameters x 3) of all observations one after the other, those
  // of a track from its own place on: most of the memory of a solve.
  Points point_steps_;
  std::unique_ptr<double[]> back_blocks_;
  std::vector<size_t> back_block_begins_;  // by track
};

}  // namespace mfir
