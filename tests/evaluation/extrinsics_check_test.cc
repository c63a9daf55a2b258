// Cameras that are found to contradict their extrinsics.

#include "src/evaluation/extrinsics_check.h"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>

#include "colmap_ext/models/camera_models.h"

namespace mfir {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

std::vector<size_t> FindCameras(const std::vector<double>& stds_px,
                                const std::vector<double>& own_stds_px) {
  std::vector<size_t> cameras;
  for (const auto& found :
       FindExtrinsicsContradictions(stds_px, stds_px, own_stds_px)) {
    cameras.push_back(found.camera_idx);
  }
  return cameras;
}

TEST(ExtrinsicsCheck, FlagsWhatIsFarAboveTheOthersAndItsOwn) {
  EXPECT_EQ(FindCameras({0.5, 0.6, 5.0, 0.5}, {0.5, 0.6, 0.6, 0.5}),
            std::vector<size_t>({2}));
}

TEST(ExtrinsicsCheck, BadKeypointsAreNoContradiction) {
  EXPECT_TRUE(FindCameras({0.5, 0.6, 5.0, 0.5}, {0.5, 0.6, 4.0, 0.5}).empty());
}

TEST(ExtrinsicsCheck, NoiseOfAllOrTinyResidualsAreNoContradiction) {
  EXPECT_TRUE(FindCameras({5.0, 6.0, 7.0}, {0.5, 0.5, 0.5}).empty());
  EXPECT_TRUE(FindCameras({1e-9, 1e-9, 0.4}, {1e-12, 1e-12, 1e-12}).empty());
}

TEST(ExtrinsicsCheck, WhereAllAreSpoiltTheStartTells) {
  const auto found = FindExtrinsicsContradictions(
      {5.0, 90.0, 6.0, 7.0}, {8.0, 9.0, 10.0, 9.0}, {0.5, 0.5, 0.5, 0.5});
  ASSERT_EQ(found.size(), 1u);
  EXPECT_EQ(found[0].camera_idx, 1u);
}

TEST(ExtrinsicsCheck, CamerasWithoutObservations) {
  EXPECT_EQ(FindCameras({kNaN, 0.5, 0.5, 9.0}, {kNaN, 0.5, 0.5, 0.5}),
            std::vector<size_t>({3}));
  EXPECT_TRUE(FindCameras({kNaN}, {kNaN}).empty());
  EXPECT_TRUE(FindCameras({}, {}).empty());
}

// Pinhole cameras that start at 1000 px and end at these focal lengths.
SceneEstimate SceneWithFocalLengths(const std::vector<double>& focal_lengths) {
  SceneEstimate result;
  for (const double focal_length : focal_lengths) {
    RigCamera camera;
    camera.model = FindCameraModel("PINHOLE");
    camera.params = {1000.0, 1000.0, 320.0, 240.0};
    result.scene.cameras.push_back(camera);
    camera.params[0] = focal_length;
    result.estimate.cameras.push_back(camera);
  }
  return result;
}

TEST(ExtrinsicsCheck, CountsSpoiltCameras) {
  const SceneEstimate refined =
      SceneWithFocalLengths({9e9, 1000.0, 1990.0, 2010.0, 490.0, 9e9, kNaN});
  const std::vector<double> own_stds_px(7, 0.5);
  // The first contradicts its extrinsics, the sixth has no observations.
  const std::vector<ExtrinsicsContradiction> contradictions = {
      {0, 90.0, 0.5, 0.5}};
  const auto count = [&](double std_px) {
    return CountSpoiltCameras(refined.scene,
                              refined.estimate,
                              contradictions,
                              {90.0, std_px, 0.5, 0.5, 0.5, kNaN, 0.5},
                              own_stds_px);
  };
  const SpoiltCameras focal_lengths_only = count(1.4);
  EXPECT_EQ(focal_lengths_only.num_others, 5u);
  EXPECT_EQ(focal_lengths_only.num_spoilt, 3u);
  EXPECT_TRUE(focal_lengths_only.Most());
  EXPECT_EQ(count(1.6).num_spoilt, 4u);
}

TEST(ExtrinsicsCheck, HalfSpoiltIsNotMost) {
  const std::vector<double> own_stds_px(4, 0.5);
  const SceneEstimate refined =
      SceneWithFocalLengths({1000.0, 1000.0, 1000.0, 1000.0});
  const auto count = [&](const std::vector<double>& stds_px) {
    return CountSpoiltCameras(
        refined.scene, refined.estimate, {}, stds_px, own_stds_px);
  };
  EXPECT_FALSE(count({0.5, 0.5, 0.5, 0.5}).Most());
  EXPECT_FALSE(count({5.0, 5.0, 0.5, 0.5}).Most());
  EXPECT_TRUE(count({5.0, 5.0, 5.0, 0.5}).Most());
  EXPECT_FALSE(count({kNaN, kNaN, kNaN, kNaN}).Most());
}

TEST(ExtrinsicsCheck, StdOfGaussianNoise) {
  Scene scene;
  scene.cameras.resize(3);
  Frame frame;
  frame.images.resize(2);
  frame.images[0].camera_idx = 2;
  frame.images[1].camera_idx = 0;
  frame.observations.resize(4);
  frame.observations[3].image_idx = 1;
  scene.frames = {frame};
  const double median = 2.0 * std::log(2.0) * 9.0;
  const std::vector<double> stds =
      RobustStdByCamera(scene, {0.0, median, 1e30, 4.0 * median});
  EXPECT_NEAR(stds[0], 6.0, 1e-12);
  EXPECT_TRUE(std::isnan(stds[1]));
  EXPECT_NEAR(stds[2], 3.0, 1e-12);
}

}  // namespace
}  // namespace mfir
