#include "src/estimators/fixed_extrinsics_solver.h"

#include <cmath>

#include <gtest/gtest.h>

#include "tests/support/test_scenes.h"

namespace mfir {
namespace {

const ceres::TrivialLoss kTrivialLoss;

FixedExtrinsicsOptions Options(const ceres::LossFunction* loss) {
  FixedExtrinsicsOptions options;
  options.loss = loss;
  return options;
}

// A frame of weight 2 is the frame twice, one of weight 0 is none.
TEST(FixedExtrinsicsRobustness, FrameWeightsCountFrames) {
  const ceres::CauchyLoss loss(2.0);
  const Scene start = MakeTestScene({}).start;
  Scene weighted = start;
  FixedExtrinsicsOptions options = Options(&loss);
  options.frame_weights = {2.0, 1.0};
  const double weighted_cost =
      SolveFixedExtrinsics(options, &weighted).final_cost;
  Scene twice = start;
  twice.frames.push_back(twice.frames[0]);
  const double twice_cost =
      SolveFixedExtrinsics(Options(&loss), &twice).final_cost;
  EXPECT_NEAR(weighted_cost, twice_cost, 1e-11 * twice_cost);
  EXPECT_LT(MaxParamsDifference(weighted, twice), 1e-9);

  Scene equal = start;
  SolveFixedExtrinsics(Options(&loss), &equal);
  EXPECT_GT(MaxParamsDifference(weighted, equal), 1e-5);

  Scene only_first = start;
  options.frame_weights = {1.0, 0.0};
  EXPECT_TRUE(SolveFixedExtrinsics(options, &only_first).converged);
  Scene first = start;
  first.frames.resize(1);
  SolveFixedExtrinsics(Options(&loss), &first);
  EXPECT_LT(MaxParamsDifference(only_first, first), 1e-9);
}

TEST(FixedExtrinsicsRobustness, CommonFactorOfTheWeightsDoesNotMatter) {
  const ceres::CauchyLoss loss(2.0);
  const Scene start = MakeTestScene({}).start;
  Scene expected = start;
  SolveFixedExtrinsics(Options(&loss), &expected);
  for (const double weight : {1e-9, 1e9}) {
    Scene scene = start;
    FixedExtrinsicsOptions options = Options(&loss);
    options.frame_weights = {weight, weight};
    options.prior_weight = weight;
    EXPECT_TRUE(SolveFixedExtrinsics(options, &scene).converged);
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
  Scene without = MakeTestScene({}).start;
  Frame& frame = without.frames[0];
  // Just behind camera 0, which has the track's first observation.
  for (size_t k = frame.track_begins[5]; k < frame.track_begins[6]; ++k) {
    if (frame.observations[k].image_idx == 0) {
      std::swap(frame.observations[k],
                frame.observations[frame.track_begins[5]]);
    }
  }
  const RigCamera& behind = without.cameras[0];
  frame.points[5] = behind.cam_from_world.Center() -
                    behind.cam_from_world.rotation.conjugate() *
                        Eigen::Vector3d(0.01, 0.02, 0.1);
  Scene with = without;
  const size_t removed = frame.track_begins[5];
  RemoveObservation(5, removed, &frame);
  EXPECT_TRUE(std::isinf(SquaredResiduals(with)[removed]));

  const ceres::CauchyLoss loss(1.0);
  // Unless points may move to where their rays meet: then all take part.
  Scene moved = with;
  Scene start = MakeTestScene({}).start;
  EXPECT_NEAR(SolveFixedExtrinsics(Options(&loss), &moved).final_cost,
              SolveFixedExtrinsics(Options(&loss), &start).final_cost,
              1e-9);
  EXPECT_LT(MaxParamsDifference(moved, start), 1e-9);

  FixedExtrinsicsOptions options = Options(&loss);
  options.improve_points = false;
  const FixedExtrinsicsSummary expected =
      SolveFixedExtrinsics(options, &without);
  const FixedExtrinsicsSummary summary = SolveFixedExtrinsics(options, &with);
  EXPECT_TRUE(summary.converged);
  EXPECT_TRUE(std::isfinite(summary.final_cost));
  EXPECT_NEAR(summary.final_cost, expected.final_cost, 1e-9);
  EXPECT_LT(MaxParamsDifference(with, without), 1e-9);
}

TEST(FixedExtrinsicsRobustness, PointsOfOneObservationOrNoneStayAsTheyAre) {
  const Scene start = MakeTestScene({}).start;
  Scene expected = start;
  Scene scene = start;
  Frame& frame = scene.frames[1];
  const Eigen::Vector3d single(0.1, 0.2, 0.3);
  frame.points.push_back(single);
  frame.observations.push_back({2, Eigen::Vector2d(400, 300)});
  frame.track_begins.push_back(frame.observations.size());
  frame.points.push_back(2.0 * single);
  frame.track_begins.push_back(frame.observations.size());
  const ceres::CauchyLoss loss(1.0);
  SolveFixedExtrinsics(Options(&loss), &expected);
  EXPECT_TRUE(SolveFixedExtrinsics(Options(&loss), &scene).converged);
  EXPECT_EQ(frame.points[frame.points.size() - 2], single);
  EXPECT_EQ(frame.points.back(), 2.0 * single);
  EXPECT_LT(MaxParamsDifference(scene, expected), 1e-9);
}

TEST(FixedExtrinsicsRobustness, CamerasWithoutObservationsStayAsTheyAre) {
  const Scene start = MakeTestScene({}).start;
  Scene scene = start;
  RigCamera unobserved = start.cameras[0];
  unobserved.params = {900, 901, 402, 303};
  scene.cameras.insert(scene.cameras.begin(), unobserved);
  unobserved.model = nullptr;  // not even an image
  unobserved.params.clear();
  scene.cameras.push_back(unobserved);
  for (Frame& frame : scene.frames) {
    for (FrameImage& image : frame.images) ++image.camera_idx;
  }
  const ceres::CauchyLoss loss(1.0);
  FixedExtrinsicsOptions options = Options(&loss);
  options.compute_covariance = true;
  const FixedExtrinsicsSummary summary = SolveFixedExtrinsics(options, &scene);
  EXPECT_TRUE(summary.converged);
  EXPECT_EQ(scene.cameras[0].params, (std::vector<double>{900, 901, 402, 303}));
  Scene expected = start;
  SolveFixedExtrinsics(options, &expected);
  for (size_t i = 0; i < expected.cameras.size(); ++i) {
    EXPECT_EQ(scene.cameras[i + 1].params, expected.cameras[i].params);
  }
  ASSERT_EQ(summary.covariance.rows(), 4 + 8 * 4);
  EXPECT_TRUE(summary.covariance.topRows(4).isZero(0.0));
  EXPECT_GT(summary.covariance(4, 4), 0.0);
}

TEST(FixedExtrinsicsRobustness, EmptyScenesAndNothingToRefineConverge) {
  const ceres::CauchyLoss loss(1.0);
  FixedExtrinsicsOptions options = Options(&loss);
  options.compute_covariance = true;
  Scene empty;
  EXPECT_TRUE(SolveFixedExtrinsics(options, &empty).converged);
  Scene no_frames = MakeTestScene({}).start;
  no_frames.frames.clear();
  EXPECT_TRUE(SolveFixedExtrinsics(options, &no_frames).converged);

  options.refine_focal_length = false;
  options.refine_principal_point = false;
  options.refine_extra_params = false;
  Scene scene = MakeTestScene({}).start;
  const FixedExtrinsicsSummary summary = SolveFixedExtrinsics(options, &scene);
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
    Scene start = scene.start;
    EXPECT_TRUE(SolveFixedExtrinsics(Options(loss), &start).converged);
    EXPECT_LT(MaxParamsDifference(start, scene.truth), 1e-7);
    // Started at the solution, cost zero.
    Scene at_truth = scene.truth;
    EXPECT_TRUE(SolveFixedExtrinsics(Options(loss), &at_truth).converged);
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
        SolveFixedExtrinsics(Options(&loss), &scene.start);
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
  const Scene start = MakeTestScene(scene_options).start;
  Scene scene = start;
  Scene moved = start;
  Random random({7});
  for (Frame& frame : moved.frames) {
    for (Eigen::Vector3d& xyz : frame.points) {
      xyz += RandomVector(&random, 0.05);
    }
  }
  Scene unimproved = start;
  Scene moved_unimproved = moved;
  FixedExtrinsicsOptions options = Options(&loss);
  const double cost = SolveFixedExtrinsics(options, &scene).final_cost;
  EXPECT_NEAR(
      SolveFixedExtrinsics(options, &moved).final_cost, cost, 1e-10 * cost);
  EXPECT_LT(MaxParamsDifference(scene, moved), 1e-8);
  options.improve_points = false;
  EXPECT_GT(SolveFixedExtrinsics(options, &unimproved).final_cost, cost);
  EXPECT_GT(SolveFixedExtrinsics(options, &moved_unimproved).final_cost, cost);
}

TEST(FixedExtrinsicsRobustness, RelinearizesFromAFarStart) {
  TestSceneOptions scene_options;
  scene_options.start_error = 8.0;  // focal lengths off by 8 %, points by 0.08
  TestScene scene = MakeTestScene(scene_options);
  const FixedExtrinsicsSummary summary =
      SolveFixedExtrinsics(Options(&kTrivialLoss), &scene.start);
  EXPECT_TRUE(summary.converged);
  EXPECT_LT(MaxParamsDifference(scene.start, scene.truth), 5e-3);
}

}  // namespace
}  // namespace mfir
