// COLMAP's bundle adjustment as terms of a problem that has others besides:
// residuals of the observations of images in any number of reconstructions, and
// what is held constant. Poses are blocks of a quaternion (w, x, y, z) and a
// translation.

#pragma once

#include <memory>

#include <ceres/ceres.h>
#include <Eigen/Core>

#include "colmap_ext/host/reconstruction.h"
#include "src/geometry/rigid3.h"

namespace mfir::host {

// COLMAP's residual of an observation: quaternion, translation, point and
// intrinsics are variables.
std::unique_ptr<ceres::CostFunction> CreateReprojErrorCostFunction(
    int model_id, const Eigen::Vector2d& xy);

// The same with the pose fixed: point and intrinsics are variables.
std::unique_ptr<ceres::CostFunction> CreateReprojErrorCostFunction(
    int model_id, const Rigid3& cam_from_world, const Eigen::Vector2d& xy);

struct BundleAdjustmentOptions {
  bool refine_focal_length = true;
  bool refine_principal_point = true;
  bool refine_extra_params = true;
};

class BundleAdjuster {
 public:
  explicit BundleAdjuster(const BundleAdjustmentOptions& options);
  ~BundleAdjuster();

  ceres::Problem* Problem();

  // COLMAP's own.
  ceres::Solver::Options SolverOptions() const;

  // Of all reconstructions.
  void SetConstantCamera(camera_t camera_id);

  // What follows is of this reconstruction, which must outlive the solve.
  void BeginReconstruction(Reconstruction* reconstruction);

  struct PoseBlocks {
    double* rotation = nullptr;  // w, x, y, z; null: no observation, no block
    double* translation = nullptr;
  };
  // Adds the residuals of its observations. Blocks of points and intrinsics are
  // those of the reconstruction.
  PoseBlocks AddImage(image_t image_id, ceres::LossFunction* loss);

  // Holds what the options and SetConstantCamera say.
  void EndReconstruction();

  // After the solve: the reconstructions get their poses.
  void UpdatePoses();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

// COLMAP's own adjustment of all poses and points with a robust loss, the
// intrinsics held. One thread: the same bits each time. False if the solver
// fails.
bool AdjustPosesAndPoints(Reconstruction* reconstruction);

// The block of a camera's intrinsics.
double* ParamsData(camera_t camera_id, Reconstruction* reconstruction);

}  // namespace mfir::host
