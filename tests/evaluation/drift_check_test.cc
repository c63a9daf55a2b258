#include "src/evaluation/drift_check.h"

#include <cmath>

#include <gtest/gtest.h>

#include "tests/support/test_scenes.h"

namespace mfir {
namespace {

std::vector<RigCamera> MakeCameras(size_t count) {
  std::vector<RigCamera> cameras = MakeTestScene({}).start.estimate.cameras;
  cameras.resize(count, cameras[0]);
  for (RigCamera& camera : cameras) camera.params = {1000, 1000, 320, 240};
  return cameras;
}

DriftReference Params(const std::vector<RigCamera>& cameras) {
  DriftReference reference;
  for (const RigCamera& camera : cameras) reference.push_back(camera.params);
  return reference;
}

std::vector<std::optional<CameraDrift>> FindDrifts(
    const std::vector<RigCamera>& cameras, const DriftReference& before) {
  return FindDrifts(cameras, std::vector<size_t>(cameras.size(), 100), before);
}

TEST(FindDrifts, MeasuresChangesAgainstTheOthers) {
  std::vector<RigCamera> cameras = MakeCameras(8);
  const DriftReference before = Params(cameras);
  for (RigCamera& camera : cameras) {
    camera.params[0] += 10.0;  // 10 permille
    camera.params[2] += 2.0;
  }
  cameras[3].params[1] += 40.0;  // mean of 10 and 50 - 10 = 40 permille
  cameras[5].params[3] -= 8.0;
  const auto drifts = FindDrifts(cameras, before);
  for (size_t i = 0; i < 8; ++i) {
    ASSERT_TRUE(drifts[i].has_value());
    EXPECT_EQ(drifts[i]->is_unusual, i == 3 || i == 5) << i;
  }
  EXPECT_NEAR(drifts[0]->focal_permille, 5.0, 1e-9);
  EXPECT_NEAR(drifts[3]->focal_permille, 25.0, 1e-9);
  EXPECT_NEAR(drifts[3]->others_focal_permille, 5.0, 1e-9);
  // The others have changed alike: 20 permille in units of the floor.
  EXPECT_NEAR(drifts[3]->focal_stds, 20.0 / 0.5, 1e-9);
  EXPECT_NEAR(drifts[5]->principal_point.y(), -8.0, 1e-12);
  EXPECT_NEAR(drifts[5]->principal_point_stds, 8.0 / 0.25, 1e-9);
  // Half of the others' coordinates have changed by 2 px, half by 0.
  EXPECT_NEAR(drifts[5]->others_principal_point, 1.0, 1e-12);
}

// What all cameras share is no reason for an alarm, nor is normal spread.
TEST(FindDrifts, HealthyArraysAreNotUnusual) {
  Random random({5});
  int num_unusual = 0;
  double sum = 0.0;
  for (int i = 0; i < 300; ++i) {
    std::vector<RigCamera> cameras = MakeCameras(6 + i % 30);
    const DriftReference before = Params(cameras);
    for (RigCamera& camera : cameras) {
      camera.params[0] *= 1.02 + random.Normal(0.0, 0.004);
      camera.params[1] = camera.params[0];
      camera.params[2] += random.Normal(3.0, 5.0);
      camera.params[3] += random.Normal(-4.0, 5.0);
    }
    for (const auto& drift : FindDrifts(cameras, before)) {
      num_unusual += drift->is_unusual;
    }
    sum += std::pow(FindDrifts(cameras, before)[0]->principal_point_stds, 2);
  }
  EXPECT_LE(num_unusual, 1);
  // The larger of two normal numbers has the mean square 1 + 2 / pi = 1.64; a
  // standard deviation from few numbers makes it more.
  EXPECT_NEAR(sum / 300.0, 2.0, 0.4);
}

TEST(FindDrifts, CamerasWithoutReferenceDoNotCount) {
  std::vector<RigCamera> cameras = MakeCameras(6);
  DriftReference before = Params(cameras);
  before[2].clear();
  cameras[2].params[2] += 50.0;
  cameras[4].params[2] += 50.0;
  const auto drifts = FindDrifts(cameras, before);
  EXPECT_FALSE(drifts[2].has_value());
  EXPECT_TRUE(drifts[4]->is_unusual);
  // Of three others nothing is known.
  before[0].clear();
  before[1].clear();
  EXPECT_FALSE(FindDrifts(cameras, before)[4]->is_unusual);
}

// A camera that few points show has larger errors, at its start and later: 9
// times fewer observations, 3 times the error.
TEST(FindDrifts, FewObservationsExcuseLargeChanges) {
  Random random({6});
  std::vector<RigCamera> cameras = MakeCameras(30);
  const DriftReference before = Params(cameras);
  std::vector<size_t> num_observations(cameras.size(), 900);
  for (RigCamera& camera : cameras) {
    camera.params[2] += random.Normal(0.0, 5.0);
    camera.params[3] += random.Normal(0.0, 5.0);
  }
  cameras[7].params[2] = before[7][2] + 40.0;
  const auto with_many = FindDrifts(cameras, num_observations, before);
  EXPECT_TRUE(with_many[7]->is_unusual);
  num_observations[7] = 100;
  const auto with_few = FindDrifts(cameras, num_observations, before);
  EXPECT_FALSE(with_few[7]->is_unusual);
  EXPECT_NEAR(with_few[7]->principal_point_stds,
              with_many[7]->principal_point_stds / 3.0,
              0.01);
  // Nor do they hide that another camera has changed.
  cameras[8].params[2] = before[8][2] + 40.0;
  EXPECT_TRUE(FindDrifts(cameras, num_observations, before)[8]->is_unusual);
  // More than the median camera is no reason to expect less change.
  num_observations[7] = 90000;
  EXPECT_EQ(FindDrifts(cameras, num_observations, before)[7]->focal_stds,
            with_many[7]->focal_stds);
}

// Images of all frames at the known poses, each turned by noise.
SceneEstimate PoseScene(double noise_deg, uint64_t seed) {
  TestSceneOptions options;
  options.num_frames = 4;
  SceneEstimate scene = MakeTestScene(options).start;
  Random random({seed});
  for (FrameEstimate& frame : scene.estimate.frames) {
    for (size_t i = 0; i < frame.images.size(); ++i) {
      Rigid3& pose = frame.images[i].cam_from_world;
      pose = scene.scene.cameras[i].cam_from_world;
      const double angle = random.Normal(0.0, noise_deg) * M_PI / 180.0;
      pose.rotation =
          Eigen::AngleAxisd(angle, RandomVector(&random, 1.0).normalized()) *
          pose.rotation;
    }
  }
  return scene;
}

std::vector<PoseDisagreement> FindDisagreements(const SceneEstimate& scene) {
  return FindPoseDisagreements(scene.scene, scene.estimate);
}

void TurnInRig(size_t camera_idx, double degrees, SceneEstimate* scene) {
  Rigid3& pose = scene->scene.cameras[camera_idx].cam_from_world;
  pose.rotation = Eigen::AngleAxisd(degrees * M_PI / 180.0,
                                    Eigen::Vector3d(0.6, 0.8, 0.0)) *
                  pose.rotation;
}

TEST(FindPoseDisagreements, NamesTheCameraThatWasTurned) {
  for (const double degrees : {0.2, 2.0}) {
    SceneEstimate scene = PoseScene(0.01, 3);
    TurnInRig(2, degrees, &scene);
    const auto disagreements = FindDisagreements(scene);
    for (size_t i = 0; i < disagreements.size(); ++i) {
      EXPECT_EQ(disagreements[i].is_moved, i == 2) << i;
    }
    EXPECT_NEAR(disagreements[2].angle_deg, degrees, 0.02);
    EXPECT_LT(disagreements[2].others_deg, 0.02);
  }
}

TEST(FindPoseDisagreements, ScatterIsNoMovement) {
  for (uint64_t seed = 0; seed < 20; ++seed) {
    for (const auto& camera : FindDisagreements(PoseScene(0.5, seed))) {
      EXPECT_FALSE(camera.is_moved);
    }
  }
  // The poses of RIG themselves.
  for (const auto& camera : FindDisagreements(PoseScene(0.0, 0))) {
    EXPECT_EQ(camera.angle_deg, 0.0);
    EXPECT_FALSE(camera.is_moved);
  }
}

// The others are turned by 0.2 degrees (a RIG that is not exact), this camera
// by 2: too much, unless it has a hundredth of their observations.
TEST(FindPoseDisagreements, FewObservationsExcuseLargeAngles) {
  SceneEstimate scene = PoseScene(0.01, 5);
  for (size_t i = 0; i < scene.scene.cameras.size(); ++i) {
    TurnInRig(i, i == 2 ? 2.0 : 0.2, &scene);
  }
  EXPECT_TRUE(FindDisagreements(scene)[2].is_moved);
  for (Frame& frame : scene.scene.frames) {
    size_t num_kept = 0;
    std::vector<Observation> kept;
    for (const Observation& observation : frame.observations) {
      const bool is_of_2 = frame.images[observation.image_idx].camera_idx == 2;
      if (!is_of_2 || num_kept++ % 100 == 0) kept.push_back(observation);
    }
    frame.observations = kept;
  }
  EXPECT_FALSE(FindDisagreements(scene)[2].is_moved);
}

// In one frame of four.
TEST(FindPoseDisagreements, OneFrameIsNotMost) {
  SceneEstimate scene = PoseScene(0.01, 4);
  Rigid3& pose = scene.estimate.frames[1].images[2].cam_from_world;
  pose.rotation =
      Eigen::AngleAxisd(0.05, Eigen::Vector3d::UnitX()) * pose.rotation;
  for (const auto& camera : FindDisagreements(scene)) {
    EXPECT_FALSE(camera.is_moved);
  }
}

}  // namespace
}  // namespace mfir
