// The points of a bundle adjustment: each one minimized on its own, given the
// cameras.

#pragma once

#include <cstddef>
#include <vector>

#include <ceres/loss_function.h>
#include <Eigen/Cholesky>
#include <Eigen/Core>

#include "src/estimators/ray_intersection.h"
#include "src/residuals/linearization.h"
#include "src/scene/scene.h"

namespace mfir {

// A point with its observations.
struct Track {
  struct Observation {
    size_t camera_idx;
    Eigen::Vector2d xy;
    // Null: none.
    const FeatureKeypoint* feature = nullptr;
    const CostMaps* cost_maps = nullptr;
    size_t cost_map_idx = 0;
  };
  Eigen::Vector3d* xyz = nullptr;
  double weight = 1.0;
  const Observation* observations = nullptr;
  size_t length = 0;
};

// How much of the second derivative of the loss is used. From one to the next,
// steps become shorter and the equations more often positive definite.
enum class Curvature { kNewton, kClamped, kReweighted };

// Hessian of 1/2 rho(|r|^2) with respect to r: rho' I + 2 rho'' r r^T. Along r
// it is rho' + 2 rho'' s, negative for outliers. kClamped: not below a share of
// rho'. kReweighted: rho' I (iterative reweighting, which never overshoots).
Eigen::Matrix2d RobustHessian(const Eigen::Vector2d& residual,
                              const double rho[3],
                              Curvature curvature);

// Normal equations of a point.
struct TrackSystem {
  // Hessian and gradient with respect to the projection. (In a struct, since
  // COLMAP specializes std::vector for the bare Eigen types.)
  struct Observation {
    Eigen::Matrix2d weight;
    Eigen::Vector2d weighted_residual;
  };
  Eigen::Vector3d gradient;
  Eigen::LLT<Eigen::Matrix3d> hessian;
  std::vector<Observation> observations;
};

// Losses of the terms of a track; null: the term is left out.
struct TrackLosses {
  const ceres::LossFunction* keypoints = nullptr;
  const ceres::LossFunction* features = nullptr;
  const ceres::LossFunction* cost_maps = nullptr;
};

// Cost of a track: weight * sum_i 1/2 rho(|r_i|^2) + 1/2 rho_f(|W_i r_f,i|^2) +
// 1/2 rho_G(|G_i|^2), with r_i the distance from keypoint to projection, r_f,i
// and W_i the same distance from the feature's keypoint and its whitening, and
// G_i the cost map at the projection (featuremetric_residual.h).
class TrackSolver {
 public:
  // The losses and `scene` (its camera models) must outlive this.
  TrackSolver(const TrackLosses& losses,
              const Scene* scene,
              std::vector<FreeParams> free_params);

  // Infinite behind a camera.
  double Cost(const Track& track,
              const std::vector<CameraState>& states,
              const Eigen::Vector3d& xyz) const;

  // The part of features and cost maps.
  double FeatureCost(const Track& track,
                     const std::vector<CameraState>& states,
                     const Eigen::Vector3d& xyz) const;

  // False behind a camera.
  bool Linearize(const Track& track,
                 const std::vector<CameraState>& states,
                 const Eigen::Vector3d& xyz,
                 std::vector<Linearization>* linearizations) const;

  // Uses less curvature than asked for where the system is not positive
  // definite, or, along some direction, has less than `min_share` of what it
  // has without the second derivative of the loss: a minimum that is about to
  // vanish, for which a quadratic model tells nothing. `damping` is relative to
  // the diagonal.
  void BuildSystem(const Track& track,
                   const std::vector<Linearization>& linearizations,
                   Curvature curvature,
                   double min_share,
                   double damping,
                   TrackSystem* system) const;

  struct Minimum {
    double cost = 0.0;
    // False where there is no regular minimum: the cost falls all the way to a
    // camera centre, where a point fits anything, or the lens model folds.
    bool converged = false;
  };

  // Moves `xyz` to the minimum of the track's cost.
  Minimum Minimize(const Track& track,
                   const std::vector<CameraState>& states,
                   Eigen::Vector3d* xyz) const;

  // Moves `xyz`, at the given minimum, to a lower one if an observation is an
  // outlier there and another choice of outliers fits better. Returns where it
  // ends.
  Minimum FindLowestMinimum(const Track& track,
                            const std::vector<CameraState>& states,
                            const Minimum& minimum,
                            Eigen::Vector3d* xyz) const;

 private:
  bool HasFeature(const Track::Observation& observation) const {
    return losses_.features != nullptr && observation.feature != nullptr;
  }
  bool HasCostMap(const Track::Observation& observation) const {
    return losses_.cost_maps != nullptr && observation.cost_maps != nullptr;
  }
  // Adds what features and cost maps contribute.
  void AddFeatureTerms(const Track& track,
                       size_t observation_idx,
                       const Eigen::Vector2d& xy,
                       Curvature curvature,
                       TrackSystem* system) const;
  double FeatureCost(const Track::Observation& observation,
                     const Eigen::Vector2d& xy) const;
  // Whether the lens model folds an observation into the image, at the given
  // linearization: polynomials do that far outside of it.
  bool IsFolded(const Track& track,
                const std::vector<CameraState>& states,
                const std::vector<Linearization>& linearizations) const;
  // Whether the loss gives an observation less than half of its weight, or
  // `xyz` is behind a camera.
  bool HasOutlier(const Track& track,
                  const std::vector<CameraState>& states,
                  const Eigen::Vector3d& xyz) const;
  std::vector<Ray> Rays(const Track& track,
                        const std::vector<CameraState>& states) const;

  const TrackLosses losses_;
  double information_at_zero_ = 0.0;  // rho'(0) of keypoints, 1/px^2
  const Scene* scene_;
  const std::vector<FreeParams> free_params_;
};

}  // namespace mfir
