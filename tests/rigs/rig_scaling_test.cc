#include "colmap_ext/rigs/rig_scaling.h"

#include <gtest/gtest.h>

#include "colmap_ext/models/camera_models.h"

namespace mfir {
namespace {

KnownCamera Camera(const char* model, const std::vector<double>& params) {
  KnownCamera camera;
  camera.model = FindCameraModel(model);
  camera.params = params;
  camera.width = 1920;
  camera.height = 1080;
  return camera;
}

TEST(RigScaling, ScalesFocalLengthsAndPrincipalPoint) {
  KnownCamera camera =
      Camera("OPENCV", {1500, 1503, 960.5, 540.5, 0.1, 0.2, 0.001, 0.002});
  ASSERT_TRUE(ScaleToImageSize(640, 360, &camera));
  const std::vector<double> expected = {
      500, 501, 960.5 / 3.0, 540.5 / 3.0, 0.1, 0.2, 0.001, 0.002};
  for (size_t i = 0; i < expected.size(); ++i) {
    EXPECT_NEAR(camera.params[i], expected[i], 1e-12);
  }
  EXPECT_EQ(camera.width, 640);
  EXPECT_EQ(camera.height, 360);
}

TEST(RigScaling, OneFocalLength) {
  KnownCamera camera = Camera("SIMPLE_PINHOLE", {1500, 960, 540});
  ASSERT_TRUE(ScaleToImageSize(3840, 2160, &camera));
  EXPECT_EQ(camera.params, std::vector<double>({3000, 1920, 1080}));
}

TEST(RigScaling, OtherRatiosStayAsTheyAre) {
  KnownCamera camera = Camera("SIMPLE_PINHOLE", {1500, 960, 540});
  // 0.16 % off.
  EXPECT_FALSE(ScaleToImageSize(641, 360, &camera));
  EXPECT_FALSE(ScaleToImageSize(1080, 1920, &camera));
  EXPECT_EQ(camera.width, 1920);
  EXPECT_EQ(camera.params, std::vector<double>({1500, 960, 540}));
  // 0.05 %.
  EXPECT_TRUE(ScaleToImageSize(1919, 1080, &camera));
}

TEST(RigScaling, Advice) {
  const auto advice = [](size_t width, size_t height) {
    return ImageSizeAdvice(width, height, 1920, 1080);
  };
  EXPECT_NE(advice(1080, 1920).find("EXIF"), std::string::npos);
  EXPECT_NE(advice(640, 360).find("--MultiFrame.scale_intrinsics 1"),
            std::string::npos);
  EXPECT_NE(advice(640, 480).find("images of that resolution"),
            std::string::npos);
}

}  // namespace
}  // namespace mfir
