#include "src/estimators/fixed_extrinsics_solver.h"

#include <cmath>

#include <gtest/gtest.h>

#include "src/residuals/noise_samples.h"
#include "tests/support/test_scenes.h"

namespace mfir {
namespace {

// A frame of weight 2 is the frame twice, one of weight 0 is none.
TEST(FixedExtrinsicsRobustness, FrameWeightsCountFrames) {
  const ceres::CauchyLoss loss(2.0);
  const SceneEstimate start = MakeTestScene({}).start;
  SceneEstimate weighted = start;
  FixedExtrinsicsOptions options = OptionsWithLoss(&loss);
  options.frame_weights = {2.0, 1.0};
  const double weighted_cost = Solve(options, &weighted).final_cost;
  SceneEstimate twice = start;
  twice.scene.frames.push_back(twice.scene.frames[0]);
  twice.estimate.frames.push_back(twice.estimate.frames[0]);
  const double twice_cost = Solve(OptionsWithLoss(&loss), &twice).final_cost;
  EXPECT_NEAR(weighted_cost, twice_cost, 1e-11 * twice_cost);
  EXPECT_LT(MaxParamsDifference(weighted, twice), 1e-9);

  SceneEstimate equal = start;
  Solve(OptionsWithLoss(&loss), &equal);
  EXPECT_GT(MaxParamsDifference(weighted, equal), 1e-5);

  SceneEstimate only_first = start;
  options.frame_weights = {1.0, 0.0};
  EXPECT_TRUE(Solve(options, &only_first).converged);
  SceneEstimate first = start;
  first.scene.frames.resize(1);
  first.estimate.frames.resize(1);
  Solve(OptionsWithLoss(&loss), &first);
  EXPECT_LT(MaxParamsDifference(only_first, first), 1e-9);
}

TEST(FixedExtrinsicsRobustness, CommonFactorOfTheWeightsDoesNotMatter) {
  const ceres::CauchyLoss loss(2.0);
  const SceneEstimate start = MakeTestScene({}).start;
  SceneEstimate expected = start;
  Solve(OptionsWithLoss(&loss), &expected);
  for (const double weight : {1e-9, 1e9}) {
    SceneEstimate scene = start;
    FixedExtrinsicsOptions options = OptionsWithLoss(&loss);
    options.frame_weights = {weight, weight};
    options.prior_weight = weight;
    EXPECT_TRUE(Solve(options, &scene).converged);
    EXPECT_LT(MaxParamsDifference(scene, expected), 1e-9);
  }
}

void RemoveObservation(size_t point_idx, size_t observation_idx, Frame* frame) {
  frame->observations.erase(frame->observations.begin() +
                            static_cast<std::ptrdiff_t>(observation_idx));
  for (size_t i = point_idx + 1; i < frame->track_begins.size(); ++i) {
    --frame->track_begins[i];
  }
}

TEST(FixedExtrinsicsRobustness, ObservationsBehindTheCameraTakeNoPart) {
  SceneEstimate without = MakeTestScene({}).start;
  Frame& frame = without.scene.frames[0];
  // Just behind camera 0, which has the track's first observation.
  for (size_t k = frame.track_begins[5]; k < frame.track_begins[6]; ++k) {
    if (frame.observations[k].image_idx == 0) {
      std::swap(frame.observations[k],
                frame.observations[frame.track_begins[5]]);
    }
  }
  const RigCamera& behind = without.estimate.cameras[0];
  without.estimate.frames[0].points[5] =
      behind.cam_from_world.Center() -
      behind.cam_from_world.rotation.conjugate() *
          Eigen::Vector3d(0.01, 0.02, 0.1);
  SceneEstimate with = without;
  const size_t removed = frame.track_begins[5];
  RemoveObservation(5, removed, &frame);
  EXPECT_TRUE(std::isinf(SquaredResiduals(with.scene, with.estimate)[removed]));

  const ceres::CauchyLoss loss(1.0);
  // Unless points may move to where their rays meet: then all take part.
  SceneEstimate moved = with;
  SceneEstimate start = MakeTestScene({}).start;
  EXPECT_NEAR(Solve(OptionsWithLoss(&loss), &moved).final_cost,
              Solve(OptionsWithLoss(&loss), &start).final_cost,
              1e-9);
  EXPECT_LT(MaxParamsDifference(moved, start), 1e-9);

  FixedExtrinsicsOptions options = OptionsWithLoss(&loss);
  options.improve_points = false;
  const FixedExtrinsicsSummary expected = Solve(options, &without);
  const FixedExtrinsicsSummary summary = Solve(options, &with);
  EXPECT_TRUE(summary.converged);
  EXPECT_TRUE(std::isfinite(summary.final_cost));
  EXPECT_NEAR(summary.final_cost, expected.final_cost, 1e-9);
  EXPECT_LT(MaxParamsDifference(with, without), 1e-9);
}

TEST(FixedExtrinsicsRobustness, PointsOfOneObservationOrNoneStayAsTheyAre) {
  const SceneEstimate start = MakeTestScene({}).start;
  SceneEstimate expected = start;
  SceneEstimate scene = start;
  Frame& frame = scene.scene.frames[1];
  const Eigen::Vector3d single(0.1, 0.2, 0.3);
  std::vector<Eigen::Vector3d>& points = scene.estimate.frames[1].points;
  points.push_back(single);
  frame.observations.push_back({2, Eigen::Vector2d(400, 300)});
  frame.track_begins.push_back(frame.observations.size());
  points.push_back(2.0 * single);
  frame.track_begins.push_back(frame.observations.size());
  const ceres::CauchyLoss loss(1.0);
  Solve(OptionsWithLoss(&loss), &expected);
  EXPECT_TRUE(Solve(OptionsWithLoss(&loss), &scene).converged);
  const std::vector<Eigen::Vector3d>& solved = scene.estimate.frames[1].points;
  EXPECT_EQ(solved[solved.size() - 2], single);
  EXPECT_EQ(solved.back(), 2.0 * single);
  EXPECT_LT(MaxParamsDifference(scene, expected), 1e-9);
}

TEST(FixedExtrinsicsRobustness, CamerasWithoutObservationsStayAsTheyAre) {
  const SceneEstimate start = MakeTestScene({}).start;
  SceneEstimate scene = start;
  RigCamera unobserved = start.estimate.cameras[0];
  unobserved.params = {900, 901, 402, 303};
  scene.estimate.cameras.insert(scene.estimate.cameras.begin(), unobserved);
  unobserved.model = nullptr;  // not even an image
  unobserved.params.clear();
  scene.estimate.cameras.push_back(unobserved);
  scene.scene.cameras = scene.estimate.cameras;
  for (Frame& frame : scene.scene.frames) {
    for (FrameImage& image : frame.images) ++image.camera_idx;
  }
  const ceres::CauchyLoss loss(1.0);
  FixedExtrinsicsOptions options = OptionsWithLoss(&loss);
  options.compute_covariance = true;
  const FixedExtrinsicsSummary summary = Solve(options, &scene);
  EXPECT_TRUE(summary.converged);
  EXPECT_EQ(scene.estimate.cameras[0].params,
            (std::vector<double>{900, 901, 402, 303}));
  SceneEstimate expected = start;
  Solve(options, &expected);
  for (size_t i = 0; i < expected.estimate.cameras.size(); ++i) {
    EXPECT_EQ(scene.estimate.cameras[i + 1].params,
              expected.estimate.cameras[i].params);
  }
  ASSERT_EQ(summary.covariance.rows(), 4 + 8 * 4);
  EXPECT_TRUE(summary.covariance.topRows(4).isZero(0.0));
  EXPECT_GT(summary.covariance(4, 4), 0.0);
}

TEST(FixedExtrinsicsRobustness, EmptyScenesAndNothingToRefineConverge) {
  const ceres::CauchyLoss loss(1.0);
  FixedExtrinsicsOptions options = OptionsWithLoss(&loss);
  options.compute_covariance = true;
  SceneEstimate empty;
  EXPECT_TRUE(Solve(options, &empty).converged);
  SceneEstimate no_frames = MakeTestScene({}).start;
  no_frames.scene.frames.clear();
  no_frames.estimate.frames.clear();
  EXPECT_TRUE(Solve(options, &no_frames).converged);

  options.refine_focal_length = false;
  options.refine_principal_point = false;
  options.refine_extra_params = false;
  SceneEstimate scene = MakeTestScene({}).start;
  const FixedExtrinsicsSummary summary = Solve(options, &scene);
  EXPECT_TRUE(summary.converged);
  EXPECT_TRUE(std::isfinite(summary.final_cost));
  EXPECT_TRUE(summary.covariance.isZero(0.0));
}

class NoiseFreeTest : public testing::TestWithParam<const char*> {};

INSTANTIATE_TEST_SUITE_P(Models,
                         NoiseFreeTest,
                         testing::Values("SIMPLE_PINHOLE",
                                         "PINHOLE",
                                         "SIMPLE_RADIAL",
                                         "OPENCV",
                                         "FOV",
                                         "OPENCV_FISHEYE"));

TEST_P(NoiseFreeTest, RecoversTheTruth) {
  TestSceneOptions scene_options;
  scene_options.model = GetParam();
  scene_options.noise = 0.0;
  TestScene scene = MakeTestScene(scene_options);
  const ceres::CauchyLoss cauchy(1.0);
  for (const ceres::LossFunction* loss :
       {static_cast<const ceres::LossFunction*>(&cauchy),
        static_cast<const ceres::LossFunction*>(&kTrivialLoss)}) {
    SceneEstimate start = scene.start;
    EXPECT_TRUE(Solve(OptionsWithLoss(loss), &start).converged);
    EXPECT_LT(MaxParamsDifference(start, scene.truth), 1e-7);
    // Started at the solution, cost zero.
    SceneEstimate at_truth = scene.truth;
    EXPECT_TRUE(Solve(OptionsWithLoss(loss), &at_truth).converged);
    EXPECT_LT(MaxParamsDifference(at_truth, scene.truth), 1e-7);
  }
}

TEST(FixedExtrinsicsRobustness, HugeOutliersDoNotMatter) {
  for (const double size : {300.0, 1e6}) {
    TestSceneOptions scene_options;
    scene_options.num_points = 300;
    scene_options.outlier_share = 0.1;
    scene_options.outlier_size = size;
    // The points are close enough for their inliers to win.
    scene_options.start_error = 0.3;
    TestScene scene = MakeTestScene(scene_options);
    const ceres::CauchyLoss loss(1.0);
    const FixedExtrinsicsSummary summary =
        Solve(OptionsWithLoss(&loss), &scene.start);
    EXPECT_TRUE(summary.converged) << size;
    // 0.5 px of noise, 600 points: focal lengths to about 0.2 px.
    EXPECT_LT(MaxParamsDifference(scene.start, scene.truth), 5e-3) << size;
  }
}

// Tracks of three observations with outliers have several minima: without the
// search for the lowest, where a point starts decides.
TEST(FixedExtrinsicsRobustness, WherePointsStartDoesNotMatter) {
  const ceres::CauchyLoss loss(2.0);
  TestSceneOptions scene_options;
  scene_options.track_length = 3;
  scene_options.num_points = 300;
  scene_options.outlier_share = 0.2;
  const SceneEstimate start = MakeTestScene(scene_options).start;
  SceneEstimate scene = start;
  SceneEstimate moved = start;
  Random random({7});
  for (FrameEstimate& frame : moved.estimate.frames) {
    for (Eigen::Vector3d& xyz : frame.points) {
      xyz += RandomVector(&random, 0.05);
    }
  }
  SceneEstimate unimproved = start;
  SceneEstimate moved_unimproved = moved;
  FixedExtrinsicsOptions options = OptionsWithLoss(&loss);
  const double cost = Solve(options, &scene).final_cost;
  EXPECT_NEAR(Solve(options, &moved).final_cost, cost, 1e-10 * cost);
  EXPECT_LT(MaxParamsDifference(scene, moved), 1e-8);
  options.improve_points = false;
  EXPECT_GT(Solve(options, &unimproved).final_cost, cost);
  EXPECT_GT(Solve(options, &moved_unimproved).final_cost, cost);
}

TEST(FixedExtrinsicsRobustness, RelinearizesFromAFarStart) {
  TestSceneOptions scene_options;
  scene_options.start_error = 8.0;  // focal lengths off by 8 %, points by 0.08
  TestScene scene = MakeTestScene(scene_options);
  const FixedExtrinsicsSummary summary =
      Solve(OptionsWithLoss(&kTrivialLoss), &scene.start);
  EXPECT_TRUE(summary.converged);
  EXPECT_LT(MaxParamsDifference(scene.start, scene.truth), 5e-3);
}

}  // namespace
}  // namespace mfir
