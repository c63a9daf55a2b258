#include "src/dense/feature_keypoints.h"

#include <cmath>
#include <memory>

#include <gtest/gtest.h>

#include "src/estimators/fixed_extrinsics_solver.h"
#include "src/estimators/track_solver.h"
#include "tests/support/test_features.h"
#include "tests/support/test_scenes.h"

namespace mfir {
namespace {

constexpr int kPatchSize = 16;

// Cost map with squared distance = offset + (x - minimum)^T sharpness (x -
// minimum), around its keypoint.
void AddQuadraticMap(const Eigen::Vector2d& keypoint,
                     const Eigen::Vector2d& minimum,
                     const Eigen::Matrix2d& sharpness,
                     double offset,
                     double pixel_size,
                     CostMaps* maps) {
  maps->patch_size = kPatchSize;
  const Eigen::Vector2d corner =
      ((keypoint / pixel_size).array() - 0.5 * kPatchSize).round();
  const Eigen::Vector2d origin = pixel_size * (corner.array() + 0.5);
  maps->placements.push_back({origin, pixel_size});
  for (int row = 0; row < kPatchSize; ++row) {
    for (int column = 0; column < kPatchSize; ++column) {
      const Eigen::Vector2d difference =
          origin + pixel_size * Eigen::Vector2d(column, row) - minimum;
      const double squared = offset + difference.dot(sharpness * difference);
      maps->data.push_back(FloatToHalf(static_cast<float>(std::sqrt(squared))));
      maps->data.push_back(FloatToHalf(0.0f));
      maps->data.push_back(FloatToHalf(0.0f));
    }
  }
}

Eigen::Matrix2d Sharpness() {
  Eigen::Matrix2d sharpness;
  sharpness << 0.04, 0.01, 0.01, 0.09;
  return sharpness;
}

// Half a pixel, or one feature pixel, of difference would fail.
TEST(FeatureKeypoints, MinimumOfAQuadraticMap) {
  const Eigen::Vector2d keypoint(100.3, 50.9);
  for (const double pixel_size : {1.0, 4.0}) {
    for (const Eigen::Vector2d& shift :
         {Eigen::Vector2d(0.0, 0.0), Eigen::Vector2d(1.3, -2.2)}) {
      const Eigen::Vector2d minimum = keypoint + pixel_size * shift;
      CostMaps maps;
      AddQuadraticMap(keypoint, minimum, Sharpness(), 0.25, pixel_size, &maps);
      CostMapMinimum found;
      ASSERT_TRUE(FindCostMapMinimum(maps, 0, keypoint, &found));
      // fp16: 11 bits.
      EXPECT_LT((found.xy - minimum).norm(), 0.02 * pixel_size);
      EXPECT_LT((found.sharpness - Sharpness()).norm(), 0.003);
      EXPECT_NEAR(found.min_squared_distance, 0.25, 0.02);
    }
  }
}

TEST(FeatureKeypoints, NoMinimumNearTheKeypoint) {
  const Eigen::Vector2d keypoint(100.0, 50.0);
  CostMapMinimum found;
  for (const Eigen::Vector2d& shift :
       {Eigen::Vector2d(12.0, 0.0), Eigen::Vector2d(0.0, -9.0)}) {
    CostMaps maps;
    AddQuadraticMap(keypoint, keypoint + shift, Sharpness(), 0.2, 1.0, &maps);
    EXPECT_FALSE(FindCostMapMinimum(maps, 0, keypoint, &found));
  }
  CostMaps constant;
  AddQuadraticMap(
      keypoint, keypoint, Eigen::Matrix2d::Zero(), 1.0, 1.0, &constant);
  EXPECT_FALSE(FindCostMapMinimum(constant, 0, keypoint, &found));
  const Eigen::Vector2d nan = Eigen::Vector2d::Constant(std::nan(""));
  EXPECT_FALSE(FindCostMapMinimum(constant, 0, nan, &found));
  // A keypoint outside of its patch.
  EXPECT_FALSE(FindCostMapMinimum(
      constant, 0, keypoint + Eigen::Vector2d(40.0, 0.0), &found));
}

// Scene whose cost maps have their minima at the exact projections.
TestScene SceneWithFeatures(const TestSceneOptions& options,
                            const Eigen::Vector2d& offset = {0.0, 0.0}) {
  TestScene scene = MakeTestScene(options);
  for (size_t f = 0; f < scene.start.scene.frames.size(); ++f) {
    Frame& frame = scene.start.scene.frames[f];
    auto maps = std::make_shared<CostMaps>();
    for (size_t k = 0; k < frame.observations.size(); ++k) {
      AddQuadraticMap(frame.observations[k].xy,
                      scene.truth.scene.frames[f].observations[k].xy + offset,
                      Sharpness(),
                      0.25,
                      1.0,
                      maps.get());
      frame.observations[k].cost_map_idx = static_cast<int64_t>(k);
    }
    frame.cost_maps = maps;
  }
  return scene;
}

TEST(FeatureKeypoints, WhiteningOfATypicalFeature) {
  TestScene scene = SceneWithFeatures({});
  Frame& frame = scene.start.scene.frames[0];
  // One vague in x: an edge.
  auto maps = std::make_shared<CostMaps>(*frame.cost_maps);
  CostMaps edge;
  AddQuadraticMap(frame.observations[0].xy,
                  frame.observations[0].xy,
                  Eigen::Vector2d(5e-4, 0.1).asDiagonal(),
                  0.25,
                  1.0,
                  &edge);
  std::copy(edge.data.begin(), edge.data.end(), maps->data.begin());
  frame.cost_maps = maps;
  scene.start.scene = FindFeatureKeypoints(1, std::move(scene.start.scene));

  // trace(information) / 2 = 1, in the ratio of the sharpness.
  const Eigen::Matrix2d expected = Sharpness() / (0.5 * Sharpness().trace());
  const Eigen::Matrix2d& whitening = frame.feature_keypoints[5].whitening;
  EXPECT_LT((whitening.transpose() * whitening - expected).norm(), 0.05);
  const Eigen::Matrix2d& vague = frame.feature_keypoints[0].whitening;
  EXPECT_LT((vague * Eigen::Vector2d::UnitX()).norm(), 0.01);
  EXPECT_GT((vague * Eigen::Vector2d::UnitY()).norm(), 0.5);
}

// Features that are exact, beside keypoints that are not.
TEST(FeatureKeypoints, SharpFeaturesBringIntrinsicsToTheTruth) {
  const ceres::CauchyLoss loss(2.0);
  const ceres::CauchyLoss feature_loss(0.05);
  const ceres::ScaledLoss weighted(
      &feature_loss, 1e4, ceres::DO_NOT_TAKE_OWNERSHIP);
  TestScene scene = SceneWithFeatures({});
  scene.start.scene = FindFeatureKeypoints(1, std::move(scene.start.scene));
  FixedExtrinsicsOptions options;
  options.loss = &loss;
  SceneEstimate without = scene.start;
  Solve(options, &without);
  options.feature_loss = &weighted;
  const FixedExtrinsicsSummary summary = Solve(options, &scene.start);
  EXPECT_TRUE(summary.converged);
  EXPECT_GT(summary.final_feature_cost, 0.0);
  EXPECT_LT(MaxParamsDifference(scene.start, scene.truth),
            0.1 * MaxParamsDifference(without, scene.truth));

  // The same with features half a pixel off: principal points follow.
  TestScene shifted = SceneWithFeatures({}, {0.5, 0.5});
  shifted.start.scene = FindFeatureKeypoints(1, std::move(shifted.start.scene));
  Solve(options, &shifted.start);
  const auto principal_point = [](const SceneEstimate& s) {
    return s.estimate.cameras[0].params[2];
  };
  EXPECT_NEAR(
      principal_point(shifted.start) - principal_point(scene.start), 0.5, 0.15);
}

// Gradient of the cost of a track against finite differences, all terms.
class TrackGradientTest : public ::testing::TestWithParam<std::string> {};

TEST_P(TrackGradientTest, MatchesFiniteDifferences) {
  TestSceneOptions scene_options;
  scene_options.model = GetParam();
  scene_options.num_points = 5;
  TestScene scene = SceneWithFeatures(scene_options);
  scene.start.scene = FindFeatureKeypoints(1, std::move(scene.start.scene));
  Frame& frame = scene.start.scene.frames[0];
  const ceres::CauchyLoss loss(1.0);
  const ceres::CauchyLoss feature_loss(0.5);
  const ceres::HuberLoss cost_map_loss(0.3);
  const TrackSolver solver({&loss, &feature_loss, &cost_map_loss},
                           &scene.start.scene,
                           std::vector<FreeParams>(8));
  std::vector<Track::Observation> observations;
  for (size_t k = 0; k < frame.track_begins[1]; ++k) {
    observations.push_back(
        {frame.images[frame.observations[k].image_idx].camera_idx,
         frame.observations[k].xy,
         &frame.feature_keypoints[k],
         frame.cost_maps.get(),
         k});
  }
  Track track;
  track.weight = 1.7;
  track.observations = observations.data();
  track.length = observations.size();
  const std::vector<CameraState> states =
      CameraStates(scene.truth.estimate.cameras);
  const Eigen::Vector3d xyz = scene.truth.estimate.frames[0].points[0] +
                              Eigen::Vector3d(1e-4, -2e-4, 1e-4);
  std::vector<Linearization> linearizations;
  ASSERT_TRUE(solver.Linearize(track, states, xyz, &linearizations));
  TrackSystem system;
  solver.BuildSystem(
      track, linearizations, Curvature::kNewton, 0.0, 0.0, &system);
  for (int i = 0; i < 3; ++i) {
    const double h = 1e-6;
    const Eigen::Vector3d step = h * Eigen::Vector3d::Unit(i);
    const double numeric = (solver.Cost(track, states, xyz + step) -
                            solver.Cost(track, states, xyz - step)) /
                           (2.0 * h);
    EXPECT_NEAR(system.gradient(i), numeric, 1e-4 * system.gradient.norm());
  }
  EXPECT_GT(solver.FeatureCost(track, states, xyz), 0.0);
}

INSTANTIATE_TEST_SUITE_P(Models,
                         TrackGradientTest,
                         ::testing::Values("SIMPLE_PINHOLE",
                                           "PINHOLE",
                                           "SIMPLE_RADIAL",
                                           "RADIAL",
                                           "OPENCV",
                                           "OPENCV_FISHEYE",
                                           "FULL_OPENCV",
                                           "FOV",
                                           "SIMPLE_RADIAL_FISHEYE",
                                           "RADIAL_FISHEYE",
                                           "THIN_PRISM_FISHEYE"));

}  // namespace
}  // namespace mfir
