// Cameras that are found to contradict their extrinsics.

#include "src/extrinsics_check.h"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>

namespace mfir {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

std::vector<size_t> Find(const std::vector<double>& stds_px,
                         const std::vector<double>& own_stds_px) {
  std::vector<size_t> cameras;
  for (const auto& found :
       FindExtrinsicsContradictions(stds_px, stds_px, own_stds_px)) {
    cameras.push_back(found.camera_idx);
  }
  return cameras;
}

TEST(ExtrinsicsCheck, FlagsWhatIsFarAboveTheOthersAndItsOwn) {
  EXPECT_EQ(Find({0.5, 0.6, 5.0, 0.5}, {0.5, 0.6, 0.6, 0.5}),
            std::vector<size_t>({2}));
}

TEST(ExtrinsicsCheck, BadKeypointsAreNoContradiction) {
  EXPECT_TRUE(Find({0.5, 0.6, 5.0, 0.5}, {0.5, 0.6, 4.0, 0.5}).empty());
}

TEST(ExtrinsicsCheck, NoiseOfAllOrTinyResidualsAreNoContradiction) {
  EXPECT_TRUE(Find({5.0, 6.0, 7.0}, {0.5, 0.5, 0.5}).empty());
  EXPECT_TRUE(Find({1e-9, 1e-9, 0.4}, {1e-12, 1e-12, 1e-12}).empty());
}

TEST(ExtrinsicsCheck, WhereAllAreSpoiltTheStartTells) {
  const auto found = FindExtrinsicsContradictions(
      {5.0, 90.0, 6.0, 7.0}, {8.0, 9.0, 10.0, 9.0}, {0.5, 0.5, 0.5, 0.5});
  ASSERT_EQ(found.size(), 1u);
  EXPECT_EQ(found[0].camera_idx, 1u);
}

TEST(ExtrinsicsCheck, CamerasWithoutObservations) {
  EXPECT_EQ(Find({kNaN, 0.5, 0.5, 9.0}, {kNaN, 0.5, 0.5, 0.5}),
            std::vector<size_t>({3}));
  EXPECT_TRUE(Find({kNaN}, {kNaN}).empty());
  EXPECT_TRUE(Find({}, {}).empty());
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
