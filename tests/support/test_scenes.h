// Synthetic scenes with exact ground truth.

#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <ceres/cost_function.h>
#include <ceres/loss_function.h>
#include <ceres/problem.h>

#include "colmap_ext/models/camera_models.h"
#include "src/estimators/fixed_extrinsics_solver.h"
#include "src/scene/estimate.h"
#include "src/scene/scene.h"
#include "src/util/random.h"

namespace mfir {

constexpr size_t kTestWidth = 800;  // px
constexpr size_t kTestHeight = 600;

const ceres::TrivialLoss kTrivialLoss;

inline FixedExtrinsicsOptions OptionsWithLoss(const ceres::LossFunction* loss) {
  FixedExtrinsicsOptions options;
  options.loss = loss;
  return options;
}

// Plausible intrinsics of any camera model for a lens of about 1000 px.
std::vector<double> TypicalParams(const CameraModel& model);

Eigen::Quaterniond RandomRotation(Random* random);

Eigen::Vector3d RandomVector(Random* random, double sigma = 1.0);

// Rotation by a vector of that direction and angle (rad).
Eigen::Quaterniond Rotation(const Eigen::Vector3d& angle_axis);

// Cameras on a dome of 2 to 4 units, looking roughly at the origin.
std::vector<Rigid3> DomePoses(size_t num_cameras, uint64_t seed);

struct TestSceneOptions {
  std::string model = "PINHOLE";
  size_t num_cameras = 8;
  size_t num_frames = 2;
  size_t num_points = 100;  // per frame
  size_t track_length = 0;  // 0: all cameras
  double noise = 0.5;       // px per axis
  double outlier_share = 0.0;
  double outlier_size = 30.0;  // px
  double start_error = 1.0;    // 1: focal lengths off by 1 %, see MakeTestScene
  uint64_t seed = 1;
};

struct TestScene {
  SceneEstimate truth;  // exact intrinsics and points, noise-free observations
  // The same with noisy observations, wrong intrinsics (of the rig and, each
  // its own, of the images) and wrong points; poses are exact.
  SceneEstimate start;
};

TestScene MakeTestScene(const TestSceneOptions& options);

// COLMAP's residual with pose, point and intrinsics as variables.
ceres::CostFunction* ColmapCost(const CameraModel& model,
                                const Eigen::Vector2d& xy);

// COLMAP's residual with the pose fixed: variables are point and intrinsics.
ceres::CostFunction* ColmapCost(const CameraModel& model,
                                const Rigid3& pose,
                                const Eigen::Vector2d& xy);

// Reprojection errors of all observations under the rig's extrinsics, with
// COLMAP's residuals. The loss must outlive the problem.
void AddReprojectionErrors(const ceres::LossFunction* loss,
                           SceneEstimate* scene,
                           ceres::Problem* problem);

// Solves from the estimate of the scene, which becomes the solution.
FixedExtrinsicsSummary Solve(const FixedExtrinsicsOptions& options,
                             SceneEstimate* scene);

// For losses that the problem does not own.
ceres::Problem::Options SharedLoss();

// To the last digit that the cost resolves.
double SolveTightly(ceres::Problem* problem);

double Median3(double a, double b, double c);

// Largest |a - b| / max(|b|, 1) over all intrinsics of the rig.
double MaxParamsDifference(const SceneEstimate& a, const SceneEstimate& b);
}  // namespace mfir
