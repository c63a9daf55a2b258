// What SolveFixedExtrinsics adds to the reprojection errors: corrections of the
// extrinsics, priors on intrinsics, held cameras and combinations.

#include "src/estimators/fixed_extrinsics_solver.h"

#include <cmath>

#include <ceres/ceres.h>
#include <gtest/gtest.h>

#include "src/refinement/priors.h"
#include "tests/support/test_scenes.h"

namespace mfir {
namespace {

// (C - Chat) / std for a camera centre C = -R^T t.
struct CenterPriorCost {
  template <typename T>
  bool operator()(const T* const qvec, const T* const tvec, T* r) const {
    const T inverse[4] = {qvec[0], -qvec[1], -qvec[2], -qvec[3]};
    ceres::QuaternionRotatePoint(inverse, tvec, r);
    for (int i = 0; i < 3; ++i) r[i] = (-r[i] - known(i)) / std;
    return true;
  }
  Eigen::Vector3d known;
  double std;
};

// log(R Rhat^T) / std.
struct ScaledRotationPriorCost {
  template <typename T>
  bool operator()(const T* const qvec, T* r) const {
    prior(qvec, r);
    for (int i = 0; i < 3; ++i) r[i] /= T(std);
    return true;
  }
  RotationPriorCost prior;
  double std;
};

// (params[idx] - known) / std.
struct ParamPriorCost {
  template <typename T>
  bool operator()(T const* const* params, T* r) const {
    r[0] = (params[0][idx] - known) / std;
    return true;
  }
  size_t idx;
  double known;
  double std;
};

ceres::CostFunction* ParamPrior(const RigCamera& known_camera,
                                size_t idx,
                                double std) {
  auto* cost = new ceres::DynamicAutoDiffCostFunction<ParamPriorCost>(
      new ParamPriorCost{idx, known_camera.params[idx], std});
  cost->AddParameterBlock(static_cast<int>(known_camera.params.size()));
  cost->SetNumResiduals(1);
  return cost;
}

// The objective with corrected extrinsics, for Ceres. Blocks of poses are in
// `qvecs` and `tvecs`.
double SolveSoftWithCeres(const FixedExtrinsicsOptions& options,
                          SceneEstimate* scene) {
  std::vector<Eigen::Vector4d> qvecs;
  std::vector<Eigen::Vector3d> tvecs;
  for (const RigCamera& camera : scene->estimate.cameras) {
    const Eigen::Quaterniond& q = camera.cam_from_world.rotation;
    qvecs.emplace_back(q.w(), q.x(), q.y(), q.z());
    tvecs.push_back(camera.cam_from_world.translation);
  }
  ceres::Problem problem(SharedLoss());
  for (size_t f = 0; f < scene->scene.frames.size(); ++f) {
    const Frame& frame = scene->scene.frames[f];
    for (size_t i = 0; i < frame.NumPoints(); ++i) {
      for (size_t k = frame.track_begins[i]; k < frame.track_begins[i + 1];
           ++k) {
        const Observation& observation = frame.observations[k];
        const size_t c = frame.images[observation.image_idx].camera_idx;
        problem.AddResidualBlock(
            ColmapCost(*scene->estimate.cameras[c].model, observation.xy),
            const_cast<ceres::LossFunction*>(options.loss),
            qvecs[c].data(),
            tvecs[c].data(),
            scene->estimate.frames[f].points[i].data(),
            scene->estimate.cameras[c].params.data());
      }
    }
  }
  const ceres::ScaledLoss weight(
      nullptr, options.prior_weight, ceres::DO_NOT_TAKE_OWNERSHIP);
  auto* loss = const_cast<ceres::ScaledLoss*>(&weight);
  for (size_t i = 0; i < scene->estimate.cameras.size(); ++i) {
    RigCamera& camera = scene->estimate.cameras[i];
    const RigCamera& known_camera = scene->scene.cameras[i];
    problem.SetManifold(qvecs[i].data(), new ceres::QuaternionManifold);
    problem.AddResidualBlock(
        new ceres::AutoDiffCostFunction<ScaledRotationPriorCost, 3, 4>(
            new ScaledRotationPriorCost{
                RotationPriorCost(known_camera.cam_from_world.rotation),
                options.rotation_std}),
        loss,
        qvecs[i].data());
    problem.AddResidualBlock(
        new ceres::AutoDiffCostFunction<CenterPriorCost, 3, 4, 3>(
            new CenterPriorCost{known_camera.cam_from_world.Center(),
                                options.center_std}),
        loss,
        qvecs[i].data(),
        tvecs[i].data());
    const auto add = [&](double std, const std::vector<size_t>& idxs) {
      for (const size_t idx : idxs) {
        if (std == 0.0) continue;
        problem.AddResidualBlock(
            ParamPrior(known_camera, idx, std), loss, camera.params.data());
      }
    };
    add(options.focal_std, camera.model->FocalLengthIdxs());
    add(options.principal_point_std, camera.model->PrincipalPointIdxs());
  }
  const double cost = SolveTightly(&problem);
  for (size_t i = 0; i < scene->estimate.cameras.size(); ++i) {
    Rigid3& pose = scene->estimate.cameras[i].cam_from_world;
    pose.rotation =
        Eigen::Quaterniond(qvecs[i](0), qvecs[i](1), qvecs[i](2), qvecs[i](3));
    pose.translation = tvecs[i];
  }
  return cost;
}

// The known extrinsics are off by the given standard deviations.
TestScene SceneWithWrongExtrinsics(double rotation_std, double center_std) {
  TestSceneOptions scene_options;
  scene_options.num_points = 120;
  TestScene scene = MakeTestScene(scene_options);
  Random random({31});
  for (RigCamera& camera : scene.start.estimate.cameras) {
    const Eigen::Vector3d center =
        camera.cam_from_world.Center() + RandomVector(&random, center_std);
    Rigid3& pose = camera.cam_from_world;
    pose.rotation =
        (Rotation(RandomVector(&random, rotation_std)) * pose.rotation)
            .normalized();
    pose.translation = -(pose.rotation * center);
  }
  scene.start.scene.cameras = scene.start.estimate.cameras;
  return scene;
}

void ExpectSamePoses(const SceneEstimate& a,
                     const SceneEstimate& b,
                     double tolerance) {
  for (size_t i = 0; i < a.estimate.cameras.size(); ++i) {
    const Rigid3& pose = a.estimate.cameras[i].cam_from_world;
    const Rigid3& expected = b.estimate.cameras[i].cam_from_world;
    EXPECT_LT(pose.rotation.angularDistance(expected.rotation), tolerance);
    EXPECT_LT((pose.Center() - expected.Center()).norm(), tolerance);
  }
}

TEST(SoftExtrinsics, MinimumIsThatOfCeres) {
  const ceres::CauchyLoss loss(2.0);
  for (const bool intrinsics_priors : {false, true}) {
    FixedExtrinsicsOptions options = OptionsWithLoss(&loss);
    options.rotation_std = 1e-3;
    options.center_std = 2e-3;
    options.prior_weight = 0.3;
    if (intrinsics_priors) {
      options.focal_std = 3.0;
      options.principal_point_std = 1.0;
    }
    SceneEstimate ours = SceneWithWrongExtrinsics(1e-3, 2e-3).start;
    SceneEstimate expected = ours;
    const FixedExtrinsicsSummary summary = Solve(options, &ours);
    EXPECT_TRUE(summary.converged);
    const double cost = SolveSoftWithCeres(options, &expected);
    EXPECT_NEAR(summary.final_cost, cost, 1e-7 * cost);
    EXPECT_LT(MaxParamsDifference(ours, expected), 1e-6);
    ExpectSamePoses(ours, expected, 1e-7);
  }
}

TEST(SoftExtrinsics, ImproveOnWrongExtrinsics) {
  const ceres::CauchyLoss loss(2.0);
  TestScene scene = SceneWithWrongExtrinsics(2e-3, 4e-3);
  SceneEstimate pinned = scene.start;
  Solve(OptionsWithLoss(&loss), &pinned);
  SceneEstimate soft = scene.start;
  FixedExtrinsicsOptions options = OptionsWithLoss(&loss);
  options.rotation_std = 2e-3;
  options.center_std = 4e-3;
  EXPECT_TRUE(Solve(options, &soft).converged);
  EXPECT_LT(MaxParamsDifference(soft, scene.truth),
            0.85 * MaxParamsDifference(pinned, scene.truth));
  for (size_t i = 0; i < soft.estimate.cameras.size(); ++i) {
    EXPECT_NEAR(
        soft.estimate.cameras[i].cam_from_world.rotation.norm(), 1.0, 1e-12);
  }
}

TEST(SoftExtrinsics, TinyStandardDeviationsPinThem) {
  const ceres::CauchyLoss loss(2.0);
  const SceneEstimate start = SceneWithWrongExtrinsics(1e-4, 2e-4).start;
  SceneEstimate pinned = start;
  Solve(OptionsWithLoss(&loss), &pinned);
  SceneEstimate soft = start;
  FixedExtrinsicsOptions options = OptionsWithLoss(&loss);
  options.rotation_std = 1e-9;
  options.center_std = 1e-9;
  EXPECT_TRUE(Solve(options, &soft).converged);
  EXPECT_LT(MaxParamsDifference(soft, pinned), 1e-6);
  ExpectSamePoses(soft, start, 1e-7);
}

TEST(SoftExtrinsics, ResultDoesNotDependOnTheNumberOfThreads) {
  const ceres::CauchyLoss loss(2.0);
  const SceneEstimate start = SceneWithWrongExtrinsics(1e-3, 2e-3).start;
  SceneEstimate expected;
  for (const int num_threads : {1, 3}) {
    SceneEstimate scene = start;
    FixedExtrinsicsOptions options = OptionsWithLoss(&loss);
    options.rotation_std = 1e-3;
    options.center_std = 2e-3;
    options.num_threads = num_threads;
    Solve(options, &scene);
    if (num_threads == 1) expected = scene;
    for (size_t i = 0; i < scene.estimate.cameras.size(); ++i) {
      EXPECT_EQ(scene.estimate.cameras[i].params,
                expected.estimate.cameras[i].params);
      EXPECT_EQ(scene.estimate.cameras[i].cam_from_world.translation,
                expected.estimate.cameras[i].cam_from_world.translation);
    }
  }
}

TEST(IntrinsicsPriors, TinyStandardDeviationsPinTheRefinedOnes) {
  const ceres::CauchyLoss loss(2.0);
  SceneEstimate scene = MakeTestScene({}).start;
  const SceneEstimate start = scene;
  FixedExtrinsicsOptions options = OptionsWithLoss(&loss);
  options.focal_std = 1e-6;
  EXPECT_TRUE(Solve(options, &scene).converged);
  for (size_t i = 0; i < scene.estimate.cameras.size(); ++i) {
    const std::vector<double>& params = scene.estimate.cameras[i].params;
    for (const size_t idx :
         scene.estimate.cameras[i].model->FocalLengthIdxs()) {
      EXPECT_NEAR(params[idx], start.estimate.cameras[i].params[idx], 1e-6);
    }
    EXPECT_NE(params[2], start.estimate.cameras[i].params[2]);
  }
}

TEST(ConstantCameras, AreBitIdenticalAndTheOthersAreNot) {
  const ceres::CauchyLoss loss(2.0);
  const SceneEstimate start = MakeTestScene({}).start;
  SceneEstimate scene = start;
  FixedExtrinsicsOptions options = OptionsWithLoss(&loss);
  options.constant_cameras.assign(scene.estimate.cameras.size(), false);
  options.constant_cameras[3] = true;
  options.compute_covariance = true;
  const FixedExtrinsicsSummary summary = Solve(options, &scene);
  EXPECT_TRUE(summary.converged);
  for (size_t i = 0; i < scene.estimate.cameras.size(); ++i) {
    EXPECT_EQ(
        scene.estimate.cameras[i].params == start.estimate.cameras[i].params,
        i == 3);
  }
  EXPECT_TRUE(summary.covariance.middleRows(12, 4).isZero(0.0));
  EXPECT_GT(summary.covariance(11, 11), 0.0);
  EXPECT_GT(summary.covariance(16, 16), 0.0);
}

// A camera that sees one point at one place: focal length and principal point
// cannot be told apart.
TEST(MinInformation, HoldsWhatTheDataDoNotTell) {
  const ceres::CauchyLoss loss(2.0);
  SceneEstimate scene = MakeTestScene({}).start;
  for (Frame& frame : scene.scene.frames) {
    Frame kept = frame;
    kept.observations.clear();
    kept.track_begins = {0};
    for (size_t i = 0; i < frame.NumPoints(); ++i) {
      for (size_t k = frame.track_begins[i]; k < frame.track_begins[i + 1];
           ++k) {
        const bool keep = frame.observations[k].image_idx != 0 ||
                          (i == 0 && &frame == &scene.scene.frames[0]);
        if (keep) kept.observations.push_back(frame.observations[k]);
      }
      kept.track_begins.push_back(kept.observations.size());
    }
    frame = kept;
  }
  const SceneEstimate start = scene;
  FixedExtrinsicsOptions options = OptionsWithLoss(&loss);
  options.min_information = 1e-6;
  options.compute_covariance = true;
  const FixedExtrinsicsSummary summary = Solve(options, &scene);
  EXPECT_TRUE(summary.converged);
  ASSERT_EQ(summary.held_cameras.size(), scene.estimate.cameras.size());
  for (size_t i = 0; i < scene.estimate.cameras.size(); ++i) {
    EXPECT_EQ(summary.held_cameras[i], i == 0);
    for (const double param : scene.estimate.cameras[i].params) {
      EXPECT_TRUE(std::isfinite(param));
    }
  }
  EXPECT_TRUE(summary.covariance.allFinite());
  // The one observation moves the camera by its residual, not further.
  for (size_t j = 0; j < 4; ++j) {
    EXPECT_NEAR(scene.estimate.cameras[0].params[j],
                start.estimate.cameras[0].params[j],
                50.0);
  }
}

TEST(MinInformation, DoesNotTouchWellDeterminedScenes) {
  const ceres::CauchyLoss loss(2.0);
  const SceneEstimate start = MakeTestScene({}).start;
  SceneEstimate scene = start;
  FixedExtrinsicsOptions options = OptionsWithLoss(&loss);
  Solve(options, &scene);
  SceneEstimate with = start;
  options.min_information = 1e-6;
  const FixedExtrinsicsSummary summary = Solve(options, &with);
  EXPECT_EQ(summary.held_cameras,
            std::vector<bool>(start.estimate.cameras.size(), false));
  EXPECT_LT(MaxParamsDifference(with, scene), 1e-9);
}

}  // namespace
}  // namespace mfir
