#include "tests/support/test_scenes.h"

#include <algorithm>
#include <cmath>
#include <map>

#include <ceres/ceres.h>
#include <gtest/gtest.h>

#include "colmap_ext/host/bundle_adjustment.h"

namespace mfir {

std::vector<double> TypicalParams(const CameraModel& model) {
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
       {0.03, -0.02, 0.001, -0.002, 0.01, -0.005, 0.002, -0.001}},
      // Of COLMAP 4.
      {"RAD_TAN_THIN_PRISM_FISHEYE",
       {0.03,
        -0.02,
        0.01,
        -0.005,
        0.002,
        -0.001,
        0.001,
        -0.002,
        0.002,
        0.001,
        -0.001,
        0.002}},
      {"SIMPLE_DIVISION", {-0.1}},
      {"DIVISION", {-0.1}},
      {"SIMPLE_FISHEYE", {}},
      {"FISHEYE", {}},
      {"EUCM", {0.56, 0.87}}};
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

Eigen::Quaterniond RandomRotation(Random* random) {
  return Eigen::Quaterniond(random->Normal(),
                            random->Normal(),
                            random->Normal(),
                            random->Normal())
      .normalized();
}

Eigen::Vector3d RandomVector(Random* random, double sigma) {
  const double x = random->Normal(0.0, sigma);
  const double y = random->Normal(0.0, sigma);
  return {x, y, random->Normal(0.0, sigma)};
}

Eigen::Quaterniond Rotation(const Eigen::Vector3d& angle_axis) {
  const double angle = angle_axis.norm();
  if (angle == 0.0) return Eigen::Quaterniond::Identity();
  return Eigen::Quaterniond(Eigen::AngleAxisd(angle, angle_axis / angle));
}

std::vector<Rigid3> DomePoses(size_t num_cameras, uint64_t seed) {
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

TestScene MakeTestScene(const TestSceneOptions& options) {
  TestScene result;
  SceneEstimate& truth = result.truth;
  Random random({options.seed, 2});
  const CameraModel* model = FindCameraModel(options.model);
  for (const Rigid3& pose : DomePoses(options.num_cameras, options.seed)) {
    RigCamera camera;
    camera.name = "cam" + std::to_string(truth.estimate.cameras.size());
    camera.cam_from_world = pose;
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
    truth.estimate.cameras.push_back(camera);
  }
  truth.scene.cameras = truth.estimate.cameras;

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
  for (RigCamera& camera : result.start.estimate.cameras) {
    camera.params = wrong(camera.params);
  }
  result.start.scene.cameras = result.start.estimate.cameras;
  for (size_t f = 0; f < options.num_frames; ++f) {
    Frame frame;
    frame.name = "frame" + std::to_string(f);
    FrameEstimate estimate;
    for (const RigCamera& camera : truth.estimate.cameras) {
      frame.images.push_back({frame.images.size()});
      estimate.images.push_back({camera.cam_from_world, camera.params});
    }
    Frame start = frame;
    FrameEstimate start_estimate = estimate;
    for (ImageEstimate& image : start_estimate.images) {
      image.params = wrong(image.params);
    }
    std::vector<size_t> image_idxs(frame.images.size());
    for (size_t i = 0; i < image_idxs.size(); ++i) image_idxs[i] = i;
    while (frame.NumPoints() < options.num_points) {
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
        const RigCamera& camera = truth.estimate.cameras[image_idxs[k]];
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
      estimate.points.push_back(xyz);
      frame.track_begins.push_back(frame.observations.size());
      start_estimate.points.push_back(
          xyz + RandomVector(&random, 0.01 * options.start_error));
    }
    start.track_begins = frame.track_begins;
    truth.scene.frames.push_back(frame);
    truth.estimate.frames.push_back(estimate);
    result.start.scene.frames.push_back(start);
    result.start.estimate.frames.push_back(start_estimate);
  }
  return result;
}

ceres::CostFunction* ColmapCost(const CameraModel& model,
                                const Eigen::Vector2d& xy) {
  return host::CreateReprojErrorCostFunction(CameraModelId(model), xy)
      .release();
}

ceres::CostFunction* ColmapCost(const CameraModel& model,
                                const Rigid3& pose,
                                const Eigen::Vector2d& xy) {
  return host::CreateReprojErrorCostFunction(CameraModelId(model), pose, xy)
      .release();
}

void AddReprojectionErrors(const ceres::LossFunction* loss,
                           SceneEstimate* scene,
                           ceres::Problem* problem) {
  for (size_t f = 0; f < scene->scene.frames.size(); ++f) {
    const Frame& frame = scene->scene.frames[f];
    for (size_t i = 0; i < frame.NumPoints(); ++i) {
      for (size_t k = frame.track_begins[i]; k < frame.track_begins[i + 1];
           ++k) {
        const Observation& observation = frame.observations[k];
        RigCamera& camera =
            scene->estimate
                .cameras[frame.images[observation.image_idx].camera_idx];
        problem->AddResidualBlock(
            ColmapCost(*camera.model, camera.cam_from_world, observation.xy),
            const_cast<ceres::LossFunction*>(loss),
            scene->estimate.frames[f].points[i].data(),
            camera.params.data());
      }
    }
  }
}

FixedExtrinsicsSummary Solve(const FixedExtrinsicsOptions& options,
                             SceneEstimate* scene) {
  FixedExtrinsicsSummary summary =
      SolveFixedExtrinsics(options, scene->scene, scene->estimate);
  scene->estimate = summary.estimate;
  return summary;
}

ceres::Problem::Options SharedLoss() {
  ceres::Problem::Options options;
  options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  return options;
}

double SolveTightly(ceres::Problem* problem) {
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

double Median3(double a, double b, double c) {
  return std::max(std::min(a, b), std::min(std::max(a, b), c));
}

double MaxParamsDifference(const SceneEstimate& a, const SceneEstimate& b) {
  double max_difference = 0.0;
  for (size_t i = 0; i < b.estimate.cameras.size(); ++i) {
    EXPECT_EQ(a.estimate.cameras[i].params.size(),
              b.estimate.cameras[i].params.size());
    for (size_t j = 0; j < b.estimate.cameras[i].params.size(); ++j) {
      const double difference =
          std::abs(a.estimate.cameras[i].params[j] -
                   b.estimate.cameras[i].params[j]) /
          std::max(std::abs(b.estimate.cameras[i].params[j]), 1.0);
      // A NaN must not pass.
      if (!(difference <= max_difference)) max_difference = difference;
      if (std::isnan(difference)) return difference;
    }
  }
  return max_difference;
}

}  // namespace mfir
