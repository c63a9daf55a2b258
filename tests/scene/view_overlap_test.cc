#include "src/scene/view_overlap.h"

#include <algorithm>

#include <gtest/gtest.h>

#include "colmap_ext/models/camera_models.h"
#include "src/util/errors.h"
#include "tests/support/test_scenes.h"

namespace mfir {
namespace {

using Pairs = std::vector<std::pair<size_t, size_t>>;

// A camera of 60 x 40 degrees at `center`, its optical axis turned by `degrees`
// about y from +z.
RigCamera MakeCamera(const Eigen::Vector3d& center, double degrees) {
  RigCamera camera;
  camera.model = FindCameraModel("PINHOLE");
  camera.width = 600;
  camera.height = 400;
  camera.params = {519.6, 519.6, 300.0, 200.0};
  camera.cam_from_world.rotation =
      Rotation(Eigen::Vector3d(0.0, -degrees * M_PI / 180.0, 0.0));
  camera.cam_from_world.translation =
      -(camera.cam_from_world.rotation * center);
  return camera;
}

// A ring of cameras, `step` degrees apart, that look at its centre.
std::vector<RigCamera> MakeRing(size_t num_cameras,
                                double step,
                                double radius) {
  std::vector<RigCamera> cameras;
  for (size_t i = 0; i < num_cameras; ++i) {
    const double angle = i * step * M_PI / 180.0;
    cameras.push_back(MakeCamera(
        {-radius * std::sin(angle), 0.0, -radius * std::cos(angle)}, i * step));
  }
  return cameras;
}

TEST(ViewOverlap, IsTheShareOfThePixelsThatTheOtherCameraSees) {
  // Parallel, 600 pixels = 1.1547 apart at depth 1 along z: half of the image.
  const RigCamera left = MakeCamera({0.0, 0.0, 0.0}, 0.0);
  const RigCamera right = MakeCamera({0.5 * 600 / 519.6, 0.0, 0.0}, 0.0);
  EXPECT_EQ(ViewOverlap(left, left, 1.0, 10.0), 1.0);
  EXPECT_NEAR(ViewOverlap(left, right, 1.0, 90.0), 0.5, 0.13);
  EXPECT_EQ(ViewOverlap(left, right, 0.4, 90.0), 0.0);
  EXPECT_GT(ViewOverlap(left, right, 100.0, 90.0), 0.95);
  // The lines of sight at depth 1 are about 30 degrees apart.
  EXPECT_EQ(ViewOverlap(left, right, 1.0, 15.0), 0.0);
  // Back to back.
  const RigCamera back = MakeCamera({0.0, 0.0, -0.1}, 180.0);
  EXPECT_EQ(ViewOverlap(left, back, 1.0, 180.0), 0.0);
}

TEST(SelectOverlappingPairs, AngleLimitDecidesInARing) {
  const std::vector<RigCamera> cameras = MakeRing(12, 30.0, 3.0);
  const auto select = [&](double max_view_angle) {
    ViewOverlapOptions options;
    options.max_view_angle = max_view_angle;
    return SelectOverlappingPairs(options, cameras, 1);
  };
  // Points beyond the centre of the ring are seen under smaller angles than
  // that between the optical axes, so that the limit is no sharp one for these.
  const Pairs narrow = select(25.0);
  const Pairs wide = select(62.0);
  for (size_t i = 0; i < 12; ++i) {
    const std::pair<size_t, size_t> neighbours = std::minmax(i, (i + 1) % 12);
    EXPECT_EQ(std::count(narrow.begin(), narrow.end(), neighbours), 1) << i;
  }
  for (const auto& [i, j] : narrow) {
    EXPECT_LE(std::min(j - i, 12 - (j - i)), 2) << i << " " << j;
  }
  EXPECT_TRUE(
      std::includes(wide.begin(), wide.end(), narrow.begin(), narrow.end()));
  EXPECT_GT(wide.size(), narrow.size());
  EXPECT_LT(wide.size(), 66);
  EXPECT_EQ(select(180.0).size(), 66);
}

TEST(SelectOverlappingPairs, CamerasThatLookApartAreNoPair) {
  // 0 and 1 look the same way, 2 the other way.
  const std::vector<RigCamera> cameras = {MakeCamera({0.0, 0.0, 0.0}, 0.0),
                                          MakeCamera({1.0, 0.0, 0.0}, 0.0),
                                          MakeCamera({0.5, 0.0, -1.0}, 180.0)};
  EXPECT_EQ(SelectOverlappingPairs({}, cameras, 2), (Pairs{{0, 1}}));
}

TEST(SelectOverlappingPairs, UnitsOfTheWorldDoNotMatter) {
  std::vector<RigCamera> cameras = MakeRing(9, 25.0, 0.7);
  const Pairs pairs = SelectOverlappingPairs({}, cameras, 1);
  for (RigCamera& camera : cameras) {
    camera.cam_from_world.translation *= 1024.0;
  }
  EXPECT_EQ(SelectOverlappingPairs({}, cameras, 1), pairs);
  EXPECT_FALSE(pairs.empty());
}

TEST(SelectOverlappingPairs, DistortedLensesAreTakenAsTheyAre) {
  std::vector<RigCamera> cameras = MakeRing(6, 30.0, 1.0);
  for (RigCamera& camera : cameras) {
    camera.model = FindCameraModel("OPENCV");
    camera.params.insert(camera.params.end(), {-0.1, 0.02, 0.001, -0.001});
  }
  EXPECT_EQ(SelectOverlappingPairs({}, cameras, 1),
            SelectOverlappingPairs({}, MakeRing(6, 30.0, 1.0), 1));
}

TEST(SelectOverlappingPairs, OnePlaceIsAnError) {
  const std::vector<RigCamera> cameras(3, MakeCamera({1.0, 2.0, 3.0}, 0.0));
  EXPECT_THROW(SelectOverlappingPairs({}, cameras, 1), InputError);
}

}  // namespace
}  // namespace mfir
