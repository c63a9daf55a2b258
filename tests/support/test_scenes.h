// Synthetic scenes with exact ground truth.

#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include <ceres/ceres.h>
#include <gtest/gtest.h>

#include "colmap_ext/host/compat.h"
#include "colmap_ext/io/camera_models.h"
#include "src/scene/scene.h"
#include "src/util/random.h"

namespace mfir {

constexpr size_t kTestWidth = 800;  // px
constexpr size_t kTestHeight = 600;

// Plausible intrinsics of any camera model for a lens of about 1000 px.
inline std::vector<double> TypicalParams(const CameraModel& model) {
  static const std::map<std::string, std::vector<double>> extra_params = {
      {"SIMPLE_PINHOLE", {}},
      {"PINHOLE", {}},
      {"SIMPLE_RADIAL", {-0.1}},
      {"RADIAL", {-0.1, 0.05}},
      {"OPENCV", {-0.1, 0.05, 0.002, -0.001}},
      {"OPENCV_FISHEYE", {0.03, -0.02, 0.01, -0.005}},
      {"FULL_OPENCV", {-0.1, 0.05, 0.002, -0.001, 0.01, 0.03, -0.02, 0.01}},
      {"FOV", {0.6}},
      {"SIMPLE_RADIAL_FISHEYE", {0.05}},
      {"RADIAL_FISHEYE", {0.05, -0.02}},
      {"THIN_PRISM_FISHEYE",
       {0.03, -0.02, 0.001, -0.002, 0.01, -0.005, 0.002, -0.001}}};
  std::vector<double> params(model.NumParams());
  const std::vector<size_t>& focal_idxs = model.FocalLengthIdxs();
  for (size_t i = 0; i < focal_idxs.size(); ++i) {
    params[focal_idxs[i]] = 1000.0 + 4.0 * static_cast<double>(i);
  }
  params[model.PrincipalPointIdxs()[0]] = 0.5 * kTestWidth + 7.0;
  params[model.PrincipalPointIdxs()[1]] = 0.5 * kTestHeight - 5.0;
  const std::vector<double>& extra = extra_params.at(model.Name());
  for (size_t i = 0; i < extra.size(); ++i) {
    params[model.ExtraParamsIdxs()[i]] = extra[i];
  }
  return params;
}

inline Eigen::Quaterniond RandomRotation(Random* random) {
  return Eigen::Quaterniond(random->Normal(),
                            random->Normal(),
                            random->Normal(),
                            random->Normal())
      .normalized();
}

inline Eigen::Vector3d RandomVector(Random* random, double sigma = 1.0) {
  const double x = random->Normal(0.0, sigma);
  const double y = random->Normal(0.0, sigma);
  return {x, y, random->Normal(0.0, sigma)};
}

// Rotation by a vector of that direction and angle (rad).
inline Eigen::Quaterniond Rotation(const Eigen::Vector3d& angle_axis) {
  const double angle = angle_axis.norm();
  if (angle == 0.0) return Eigen::Quaterniond::Identity();
  return Eigen::Quaterniond(Eigen::AngleAxisd(angle, angle_axis / angle));
}

// Cameras on a dome of 2 to 4 units, looking roughly at the origin.
inline std::vector<Rigid3> DomePoses(size_t num_cameras, uint64_t seed) {
  Random random({seed, 1});
  std::vector<Rigid3> poses;
  for (size_t i = 0; i < num_cameras; ++i) {
    const double azimuth = 2.4 * static_cast<double>(i) + random.Normal(0, 0.1);
    const double elevation = random.Uniform(-0.5, 1.0);
    const Eigen::Vector3d center =
        random.Uniform(2.0, 4.0) *
        Eigen::Vector3d(std::cos(elevation) * std::sin(azimuth),
                        -std::sin(elevation),
                        -std::cos(elevation) * std::cos(azimuth));
    const Eigen::Vector3d z =
        (RandomVector(&random, 0.05) - center).normalized();
    const Eigen::Vector3d x = Eigen::Vector3d::UnitY().cross(z).normalized();
    Eigen::Matrix3d rotation;
    rotation << x.transpose(), z.cross(x).transpose(), z.transpose();
    Rigid3 pose;
    pose.rotation = Eigen::Quaterniond(rotation).normalized();
    pose.translation = -(pose.rotation * center);
    poses.push_back(pose);
  }
  return poses;
}

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
  Scene truth;  // exact intrinsics and points, noise-free observations
  // The same with noisy observations, wrong intrinsics (of the rig and, each
  // its own, of the images) and wrong points; poses are exact.
  Scene start;
};

inline TestScene MakeTestScene(const TestSceneOptions& options) {
  TestScene result;
  Scene& truth = result.truth;
  Random random({options.seed, 2});
  const CameraModel* model = FindCameraModel(options.model);
  for (const Rigid3& pose : DomePoses(options.num_cameras, options.seed)) {
    RigCamera camera;
    camera.name = "cam" + std::to_string(truth.cameras.size());
    camera.cam_from_world = pose;
    camera.known_cam_from_world = pose;
    camera.model = model;
    camera.width = kTestWidth;
    camera.height = kTestHeight;
    camera.params = TypicalParams(*model);
    for (const size_t idx : model->FocalLengthIdxs()) {
      camera.params[idx] *= 1.0 + random.Normal(0.0, 0.01);
    }
    for (const size_t idx : model->PrincipalPointIdxs()) {
      camera.params[idx] += random.Normal(0.0, 5.0);
    }
    camera.prior_params = camera.params;
    truth.cameras.push_back(camera);
  }

  const auto wrong = [&](std::vector<double> params) {
    for (const size_t idx : model->FocalLengthIdxs()) {
      params[idx] *= 1.0 + random.Normal(0.0, 0.01 * options.start_error);
    }
    for (const size_t idx : model->PrincipalPointIdxs()) {
      params[idx] += random.Normal(0.0, 3.0 * options.start_error);
    }
    for (const size_t idx : model->ExtraParamsIdxs()) {
      params[idx] *= 1.0 + random.Normal(0.0, 0.1 * options.start_error);
    }
    return params;
  };
  result.start = truth;
  for (RigCamera& camera : result.start.cameras) {
    camera.params = wrong(camera.params);
    camera.prior_params = camera.params;
  }
  for (size_t f = 0; f < options.num_frames; ++f) {
    Frame frame;
    frame.name = "frame" + std::to_string(f);
    for (size_t i = 0; i < truth.cameras.size(); ++i) {
      frame.images.push_back(
          {i, truth.cameras[i].cam_from_world, truth.cameras[i].params});
    }
    Frame start = frame;
    for (FrameImage& image : start.images) image.params = wrong(image.params);
    std::vector<size_t> image_idxs(frame.images.size());
    for (size_t i = 0; i < image_idxs.size(); ++i) image_idxs[i] = i;
    while (frame.points.size() < options.num_points) {
      Eigen::Vector3d xyz;
      do {
        xyz = Eigen::Vector3d::NullaryExpr(
            [&]() { return random.Uniform(-0.7, 0.7); });
      } while (xyz.norm() > 0.7);
      for (size_t i = image_idxs.size() - 1; i > 0; --i) {
        std::swap(image_idxs[i],
                  image_idxs[random.Integer(0, static_cast<int>(i))]);
      }
      const size_t length =
          options.track_length == 0 ? image_idxs.size() : options.track_length;
      for (size_t k = 0; k < length; ++k) {
        const RigCamera& camera = truth.cameras[image_idxs[k]];
        const Eigen::Vector3d p = camera.cam_from_world * xyz;
        Observation observation;
        observation.image_idx = image_idxs[k];
        model->Project(camera.params.data(),
                       p.x() / p.z(),
                       p.y() / p.z(),
                       observation.xy.data());
        frame.observations.push_back(observation);
        const bool outlier = random.Uniform() < options.outlier_share;
        for (int axis = 0; axis < 2; ++axis) {
          observation.xy(axis) += random.Normal(
              0.0, outlier ? options.outlier_size : options.noise);
        }
        start.observations.push_back(observation);
      }
      frame.points.push_back(xyz);
      frame.track_begins.push_back(frame.observations.size());
      start.points.push_back(xyz +
                             RandomVector(&random, 0.01 * options.start_error));
    }
    start.track_begins = frame.track_begins;
    truth.frames.push_back(frame);
    result.start.frames.push_back(start);
  }
  return result;
}

// COLMAP's residual with pose, point and intrinsics as variables.
inline ceres::CostFunction* ColmapCost(const CameraModel& model,
                                       const Eigen::Vector2d& xy) {
  switch (CameraModelId(model)) {
#define CAMERA_MODEL_CASE(Model) \
  case colmap::Model::kModelId:  \
    return colmap::BundleAdjustmentCostFunction<colmap::Model>::Create(xy);
    CAMERA_MODEL_CASES
#undef CAMERA_MODEL_CASE
  }
  return nullptr;
}

// COLMAP's residual with the pose fixed: variables are point and intrinsics.
inline ceres::CostFunction* ColmapCost(const CameraModel& model,
                                       const Rigid3& pose,
                                       const Eigen::Vector2d& xy) {
  const Eigen::Vector4d qvec(pose.rotation.w(),
                             pose.rotation.x(),
                             pose.rotation.y(),
                             pose.rotation.z());
  switch (CameraModelId(model)) {
#define CAMERA_MODEL_CASE(Model)                             \
  case colmap::Model::kModelId:                              \
    return colmap::BundleAdjustmentConstantPoseCostFunction< \
        colmap::Model>::Create(qvec, pose.translation, xy);
    CAMERA_MODEL_CASES
#undef CAMERA_MODEL_CASE
  }
  return nullptr;
}

// Reprojection errors of all observations under the rig's extrinsics, with
// COLMAP's residuals. The loss must outlive the problem.
inline void AddReprojectionErrors(const ceres::LossFunction* loss,
                                  Scene* scene,
                                  ceres::Problem* problem) {
  for (Frame& frame : scene->frames) {
    for (size_t i = 0; i < frame.points.size(); ++i) {
      for (size_t k = frame.track_begins[i]; k < frame.track_begins[i + 1];
           ++k) {
        const Observation& observation = frame.observations[k];
        RigCamera& camera =
            scene->cameras[frame.images[observation.image_idx].camera_idx];
        problem->AddResidualBlock(
            ColmapCost(*camera.model, camera.cam_from_world, observation.xy),
            const_cast<ceres::LossFunction*>(loss),
            frame.points[i].data(),
            camera.params.data());
      }
    }
  }
}

// For losses that the problem does not own.
inline ceres::Problem::Options SharedLoss() {
  ceres::Problem::Options options;
  options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  return options;
}

// To the last digit that the cost resolves.
inline double SolveTightly(ceres::Problem* problem) {
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.max_num_iterations = 500;
  options.function_tolerance = 1e-17;
  options.gradient_tolerance = 1e-17;
  options.parameter_tolerance = 1e-13;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, problem, &summary);
  EXPECT_TRUE(summary.IsSolutionUsable());
  return summary.final_cost;
}

// Largest |a - b| / max(|b|, 1) over all intrinsics of the rig.
inline double MaxParamsDifference(const Scene& a, const Scene& b) {
  double max_difference = 0.0;
  for (size_t i = 0; i < b.cameras.size(); ++i) {
    EXPECT_EQ(a.cameras[i].params.size(), b.cameras[i].params.size());
    for (size_t j = 0; j < b.cameras[i].params.size(); ++j) {
      const double difference =
          std::abs(a.cameras[i].params[j] - b.cameras[i].params[j]) /
          std::max(std::abs(b.cameras[i].params[j]), 1.0);
      // A NaN must not pass.
      if (!(difference <= max_difference)) max_difference = difference;
      if (std::isnan(difference)) return difference;
    }
  }
  return max_difference;
}

}  // namespace mfir
