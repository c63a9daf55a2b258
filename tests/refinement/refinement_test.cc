#include "src/refinement/refinement.h"
#include "src/scene/residual_statistics.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <gtest/gtest.h>

#include "src/estimators/fixed_extrinsics_solver.h"
#include "src/refinement/initial_intrinsics.h"
#include "tests/support/test_scenes.h"

namespace mfir {
namespace {

MultiFrameOptions Options(double loss_scale) {
  MultiFrameOptions options;
  options.ApplyPreset("accurate");
  options.loss_scale = loss_scale;
  options.num_threads = 2;
  return options;
}

MultiFrameOptions SingleFrameOptions(double loss_scale) {
  MultiFrameOptions options = Options(loss_scale);
  options.focal_variance_weight = 0.0;
  options.principal_point_variance_weight = 0.0;
  return options;
}

// Refines from the frames; the estimate of the scene becomes the result.
RefinementResult Refine(const MultiFrameOptions& options,
                        SceneEstimate* scene) {
  *scene = InitializeIntrinsics(options, *scene);
  RefinementResult result = RefineFixedExtrinsics(
      options, true, [](const Stage&) {}, scene->scene, scene->estimate);
  scene->estimate = result.estimate;
  return result;
}

TEST(RefineFixedExtrinsics, EstimatedLossRecoversNoiseAndIntrinsics) {
  TestSceneOptions scene_options;
  scene_options.num_points = 400;
  scene_options.track_length = 5;
  scene_options.outlier_share = 0.05;
  TestScene scene = MakeTestScene(scene_options);
  const RefinementResult result = Refine(Options(0.0), &scene.start);
  EXPECT_TRUE(result.converged);
  // The sigma with the same rho'(0) is on the low side, see ScaleMixtureLoss.
  EXPECT_NEAR(result.noise_std_px, 0.5, 0.1);
  EXPECT_NEAR(result.outlier_share, 0.05, 0.02);
  ASSERT_EQ(result.covariance.rows(), 32);
  double sum = 0.0;
  for (size_t i = 0; i < 8; ++i) {
    for (size_t j = 0; j < 4; ++j) {
      const double error = scene.start.estimate.cameras[i].params[j] -
                           scene.truth.estimate.cameras[i].params[j];
      const Eigen::Index row = static_cast<Eigen::Index>(4 * i + j);
      EXPECT_LT(std::abs(error), 5.0 * std::sqrt(result.covariance(row, row)));
      sum += error * error / result.covariance(row, row) / 32;
    }
  }
  EXPECT_GT(sum, 0.3);
  EXPECT_LT(sum, 2.5);
}

// With a Cauchy scale: the minimum of eq. 2, each frame of weight 1 / (number
// of frames and of its observations).
TEST(RefineFixedExtrinsics, CauchyScaleGivesTheMinimumOfThePaper) {
  TestSceneOptions scene_options;
  scene_options.outlier_share = 0.05;
  SceneEstimate scene = MakeTestScene(scene_options).start;
  // Frames of different size.
  Frame& frame = scene.scene.frames[1];
  scene.estimate.frames[1].points.resize(30);
  frame.track_begins.resize(31);
  frame.observations.resize(frame.track_begins.back());
  EXPECT_TRUE(Refine(Options(0.5), &scene).converged);

  const ceres::CauchyLoss loss(0.5);
  FixedExtrinsicsOptions options;
  options.loss = &loss;
  for (const Frame& scene_frame : scene.scene.frames) {
    options.frame_weights.push_back(
        1.0 / (2.0 * static_cast<double>(scene_frame.observations.size())));
  }
  SceneEstimate minimum = scene;
  EXPECT_TRUE(Solve(options, &minimum).converged);
  EXPECT_LT(MaxParamsDifference(minimum, scene), 1e-8);
  // Other weights have another minimum.
  options.frame_weights.clear();
  Solve(options, &minimum);
  EXPECT_GT(MaxParamsDifference(minimum, scene), 1e-6);
}

TEST(RefineFixedExtrinsics, LossScaleZeroIsEfficient) {
  double estimated = 0.0;
  double paper = 0.0;
  for (uint64_t seed = 0; seed < 4; ++seed) {
    TestSceneOptions scene_options;
    scene_options.num_points = 150;
    scene_options.outlier_share = 0.05;
    scene_options.seed = 60 + seed;
    const TestScene scene = MakeTestScene(scene_options);
    for (const double loss_scale : {0.0, 0.05}) {
      SceneEstimate refined = scene.start;
      EXPECT_TRUE(Refine(Options(loss_scale), &refined).converged);
      for (size_t i = 0; i < refined.estimate.cameras.size(); ++i) {
        const double error = refined.estimate.cameras[i].params[0] -
                             scene.truth.estimate.cameras[i].params[0];
        (loss_scale == 0.0 ? estimated : paper) += error * error;
      }
    }
  }
  EXPECT_LT(estimated, paper);
}

TEST(RefineFixedExtrinsics, UnitOfTheWorldDoesNotMatter) {
  for (const double loss_scale : {0.0, 0.5}) {
    SceneEstimate metres = MakeTestScene({}).start;
    SceneEstimate millimetres = metres;
    for (RigCamera& camera : millimetres.estimate.cameras) {
      camera.cam_from_world.translation *= 1000.0;
    }
    millimetres.scene.cameras = millimetres.estimate.cameras;
    for (FrameEstimate& frame : millimetres.estimate.frames) {
      for (ImageEstimate& image : frame.images) {
        image.cam_from_world.translation *= 1000.0;
      }
      for (Eigen::Vector3d& xyz : frame.points) xyz *= 1000.0;
    }
    Refine(Options(loss_scale), &metres);
    Refine(Options(loss_scale), &millimetres);
    EXPECT_LT(MaxParamsDifference(millimetres, metres), 1e-6) << loss_scale;
  }
}

TEST(RefineFixedExtrinsics, ExtrinsicsStayBitIdentical) {
  SceneEstimate scene = MakeTestScene({}).start;
  const SceneEstimate before = scene;
  Refine(Options(0.0), &scene);
  for (size_t i = 0; i < scene.estimate.cameras.size(); ++i) {
    const Rigid3& pose = scene.estimate.cameras[i].cam_from_world;
    EXPECT_EQ(pose.rotation.coeffs(),
              before.estimate.cameras[i].cam_from_world.rotation.coeffs());
    EXPECT_EQ(pose.translation,
              before.estimate.cameras[i].cam_from_world.translation);
  }
}

TEST(RefineFixedExtrinsics, BentPointsDoNotMatter) {
  TestScene scene = MakeTestScene({});
  SceneEstimate expected = scene.start;
  Refine(Options(0.0), &expected);
  Random random({51});
  for (FrameEstimate& frame : scene.start.estimate.frames) {
    for (Eigen::Vector3d& xyz : frame.points) {
      xyz += RandomVector(&random, 0.3);
    }
  }
  EXPECT_TRUE(Refine(Options(0.0), &scene.start).converged);
  EXPECT_LT(MaxParamsDifference(scene.start, expected), 1e-4);
}

TEST(RefineFixedExtrinsics, NoiseFreeDataGiveTheTruth) {
  TestSceneOptions scene_options;
  scene_options.noise = 0.0;
  for (const double loss_scale : {0.0, 0.25}) {
    TestScene scene = MakeTestScene(scene_options);
    EXPECT_TRUE(Refine(Options(loss_scale), &scene.start).converged);
    EXPECT_LT(MaxParamsDifference(scene.start, scene.truth), 1e-6);
  }
}

TEST(SingleFrameMode, FramesAreIndependentBitForBit) {
  for (const double loss_scale : {0.0, 0.5}) {
    TestSceneOptions scene_options;
    scene_options.outlier_share = 0.02;
    SceneEstimate scene = MakeTestScene(scene_options).start;
    SceneEstimate changed = scene;
    for (Observation& observation : changed.scene.frames[1].observations) {
      observation.xy.x() += 3.0;
    }
    for (ImageEstimate& image : changed.estimate.frames[1].images) {
      image.params[0] *= 1.01;
    }
    Refine(SingleFrameOptions(loss_scale), &scene);
    Refine(SingleFrameOptions(loss_scale), &changed);
    for (size_t i = 0; i < scene.estimate.cameras.size(); ++i) {
      EXPECT_EQ(scene.estimate.frames[0].images[i].params,
                changed.estimate.frames[0].images[i].params);
      EXPECT_NE(scene.estimate.frames[1].images[i].params,
                changed.estimate.frames[1].images[i].params);
    }
    EXPECT_EQ(scene.estimate.frames[0].points,
              changed.estimate.frames[0].points);
  }
}

TEST(SingleFrameMode, EqualsARunOfTheFrameAlone) {
  SceneEstimate scene = MakeTestScene({}).start;
  SceneEstimate alone = scene;
  alone.scene.frames.erase(alone.scene.frames.begin());
  alone.estimate.frames.erase(alone.estimate.frames.begin());
  Refine(SingleFrameOptions(0.0), &scene);
  Refine(Options(0.0), &alone);
  for (size_t i = 0; i < scene.estimate.cameras.size(); ++i) {
    for (size_t j = 0; j < 4; ++j) {
      EXPECT_NEAR(scene.estimate.frames[1].images[i].params[j],
                  alone.estimate.cameras[i].params[j],
                  1e-7);
    }
  }
}

TEST(SingleFrameMode, RigHasTheMedianOfTheFrames) {
  TestSceneOptions scene_options;
  scene_options.num_frames = 3;
  SceneEstimate scene = MakeTestScene(scene_options).start;
  const RefinementResult result = Refine(SingleFrameOptions(0.0), &scene);
  EXPECT_TRUE(result.converged);
  for (size_t i = 0; i < scene.estimate.cameras.size(); ++i) {
    for (size_t j = 0; j < 4; ++j) {
      EXPECT_EQ(scene.estimate.cameras[i].params[j],
                Median3(scene.estimate.frames[0].images[i].params[j],
                        scene.estimate.frames[1].images[i].params[j],
                        scene.estimate.frames[2].images[i].params[j]));
    }
  }
}

// A camera in one of two frames is known no better than by that frame alone.
TEST(SingleFrameMode, CovarianceCountsTheFramesThatHaveTheCamera) {
  SceneEstimate scene = MakeTestScene({}).start;
  Frame& frame = scene.scene.frames[1];
  Frame kept = frame;
  kept.images.pop_back();
  scene.estimate.frames[1].images.pop_back();
  kept.observations.clear();
  kept.track_begins = {0};
  for (size_t i = 0; i < frame.NumPoints(); ++i) {
    for (size_t k = frame.track_begins[i]; k < frame.track_begins[i + 1]; ++k) {
      if (frame.observations[k].image_idx + 1 < frame.images.size()) {
        kept.observations.push_back(frame.observations[k]);
      }
    }
    kept.track_begins.push_back(kept.observations.size());
  }
  frame = kept;
  SceneEstimate alone = scene;
  alone.scene.frames.resize(1);
  alone.estimate.frames.resize(1);
  const Eigen::MatrixXd covariance =
      Refine(SingleFrameOptions(0.0), &scene).covariance;
  const Eigen::MatrixXd expected = Refine(Options(0.0), &alone).covariance;
  for (Eigen::Index row = 28; row < 32; ++row) {
    EXPECT_NEAR(
        covariance(row, row), expected(row, row), 1e-3 * expected(row, row));
  }
}

TEST(EstimateCauchyScale, FollowsTheNoiseUnderTheFramesOwnPoses) {
  for (const double noise : {0.2, 1.0}) {
    TestSceneOptions scene_options;
    scene_options.noise = noise;
    scene_options.num_points = 400;
    scene_options.start_error = 0.0;
    SceneEstimate scene = MakeTestScene(scene_options).start;
    // Points at the least squares solution of the frame.
    const ceres::TrivialLoss loss;
    FixedExtrinsicsOptions options;
    options.loss = &loss;
    options.refine_focal_length = false;
    options.refine_principal_point = false;
    Solve(options, &scene);
    for (RigCamera& camera : scene.estimate.cameras) {
      camera.cam_from_world.translation.x() += 10.0;  // takes no part
    }
    EXPECT_NEAR(EstimateCauchyScale(scene.scene, scene.estimate),
                2.385 * noise,
                0.15 * noise);
  }
}

TEST(SquaredResiduals, SingleFrameModeUsesTheFramesIntrinsics) {
  TestSceneOptions scene_options;
  scene_options.noise = 0.0;
  SceneEstimate scene = MakeTestScene(scene_options).truth;
  scene.estimate.frames[1].images[3].params[2] += 2.0;  // cx
  const std::vector<double> rig =
      SquaredResiduals(scene.scene, scene.estimate, false);
  const std::vector<double> single =
      SquaredResiduals(scene.scene, scene.estimate, true);
  ASSERT_EQ(rig.size(), 2u * 100 * 8);
  ASSERT_EQ(single.size(), rig.size());
  for (size_t k = 0; k < rig.size(); ++k) {
    const bool changed =
        k >= 800 && scene.scene.frames[1].observations[k - 800].image_idx == 3;
    EXPECT_NEAR(rig[k], 0.0, 1e-15);
    EXPECT_NEAR(single[k], changed ? 4.0 : 0.0, 1e-9);
  }
}

TEST(InlierRms, LeavesOutResidualsAboveFourSigma) {
  // Median 2: sigma^2 = 2 / (2 ln 2) = 1.4427, limit 16 sigma^2 = 23.083.
  const std::vector<double> squared = {1.0, 2.0, 3.0, 2.0, 24.0};
  EXPECT_NEAR(MaxInlierSquaredResidual(squared), 23.0831, 1e-4);
  EXPECT_DOUBLE_EQ(InlierRms(squared), std::sqrt(2.0));
  const double inf = std::numeric_limits<double>::infinity();
  EXPECT_DOUBLE_EQ(InlierRms({2.0, 2.0, inf}), std::sqrt(2.0));
  EXPECT_TRUE(std::isnan(InlierRms({})));
}

TEST(RmsByCamera, IsOverSelectedObservations) {
  Scene scene;
  scene.cameras.resize(3);
  Frame frame;
  frame.images = {{2}, {0}};
  frame.observations = {{0, {}}, {1, {}}, {0, {}}};
  frame.track_begins = {0, 3};
  scene.frames = {frame};
  const std::vector<double> rms =
      RmsByCamera(scene, {1.0, 16.0, 9.0}, {true, true, false});
  ASSERT_EQ(rms.size(), 4u);
  EXPECT_DOUBLE_EQ(rms[0], 4.0);
  EXPECT_TRUE(std::isnan(rms[1]));
  EXPECT_DOUBLE_EQ(rms[2], 1.0);
  EXPECT_DOUBLE_EQ(rms[3], std::sqrt(8.5));
}

}  // namespace
}  // namespace mfir
