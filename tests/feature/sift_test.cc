// Hand-computed values; tests/feature/sift_extractor_test.cc compares with
// COLMAP's extractor.

#include "src/feature/sift.h"

#include <cmath>

#include <gtest/gtest.h>

#include "src/feature/scale_space.h"
#include "src/feature/sift_descriptor.h"

namespace mfir {
namespace {

// slope_x x + slope_y y.
FloatImage Ramp(int size, float slope_x, float slope_y) {
  FloatImage image(size, size);
  for (int y = 0; y < size; ++y) {
    for (int x = 0; x < size; ++x) {
      image.Row(y)[x] =
          slope_x * static_cast<float>(x) + slope_y * static_cast<float>(y);
    }
  }
  return image;
}

TEST(GaussianBlur, SpreadsAPixelByItsSigma) {
  FloatImage image(41, 41);
  image.Row(20)[20] = 1.0f;
  const double sigma = 2.5;
  const FloatImage blurred = GaussianBlur(image, sigma);
  double sum = 0.0;
  double variance_x = 0.0;
  double variance_y = 0.0;
  for (int y = 0; y < 41; ++y) {
    for (int x = 0; x < 41; ++x) {
      sum += blurred.At(x, y);
      variance_x += blurred.At(x, y) * (x - 20) * (x - 20);
      variance_y += blurred.At(x, y) * (y - 20) * (y - 20);
    }
  }
  EXPECT_NEAR(sum, 1.0, 1e-5);
  // Cut off at 4 sigma: 0.1 %.
  EXPECT_NEAR(variance_x, sigma * sigma, 0.01);
  EXPECT_NEAR(variance_y, sigma * sigma, 0.01);
  EXPECT_FLOAT_EQ(blurred.At(17, 22), blurred.At(23, 18));
}

TEST(GaussianBlur, BorderGoesOnAsItIs) {
  FloatImage image(7, 5);
  for (float& pixel : image.pixels) pixel = 0.3f;
  for (const float pixel : GaussianBlur(image, 3.0).pixels) {
    EXPECT_NEAR(pixel, 0.3f, 1e-6f);
  }
}

TEST(ScaleSpace, DoublingKeepsPixelsAndHalvingTakesThemBack) {
  FloatImage image(3, 2);
  image.pixels = {0.0f, 1.0f, 4.0f, 2.0f, 5.0f, 8.0f};
  const FloatImage doubled = Doubled(image);
  EXPECT_EQ(doubled.width, 6);
  EXPECT_EQ(doubled.height, 4);
  EXPECT_EQ(doubled.At(2, 0), 1.0f);
  EXPECT_EQ(doubled.At(3, 0), 2.5f);  // between 1 and 4
  EXPECT_EQ(doubled.At(2, 1), 3.0f);  // between 1 and 5
  EXPECT_EQ(doubled.At(3, 1), 4.5f);  // of 1, 4, 5 and 8
  EXPECT_EQ(doubled.At(5, 3), 8.0f);  // the last goes on
  EXPECT_EQ(Halved(doubled).pixels, image.pixels);
}

TEST(ScaleSpace, OctavesHaveTheirSizesAndEnd) {
  ScaleSpace space(FloatImage(33, 20), -1, 3);
  EXPECT_EQ(space.Current().index, -1);
  EXPECT_EQ(space.Current().levels.size(), 6);
  EXPECT_EQ(space.Current().levels[5].width, 66);
  ASSERT_TRUE(space.Next());
  EXPECT_EQ(space.Current().index, 0);
  EXPECT_EQ(space.Current().levels[0].width, 33);
  ASSERT_TRUE(space.Next());
  EXPECT_EQ(space.Current().levels[0].width, 16);
  ASSERT_TRUE(space.Next());
  EXPECT_EQ(space.Current().levels[0].height, 5);
  EXPECT_FALSE(space.Next());
}

TEST(SiftOrientations, AreThoseOfRamps) {
  const SiftFrame frame{30.2, 29.7, 2.0};
  const auto angle = [&frame](float slope_x, float slope_y) {
    const std::vector<double> angles =
        SiftOrientations(Ramp(61, slope_x, slope_y), frame);
    EXPECT_EQ(angles.size(), 1);
    return angles.empty() ? -1.0 : angles[0];
  };
  // A bin has 10 degrees. Down is 90 degrees.
  EXPECT_NEAR(std::cos(angle(0.01f, 0.0f)), 1.0, 1e-4);
  EXPECT_NEAR(angle(0.0f, 0.01f), M_PI / 2.0, 0.02);
  EXPECT_NEAR(angle(-0.01f, 0.0f), M_PI, 0.02);
  EXPECT_NEAR(angle(-0.01f, -0.01f), 1.25 * M_PI, 0.02);
}

TEST(SiftDescriptor, OfARampHasOneDirection) {
  const SiftFrame frame{30.0, 30.0, 2.0};
  const FloatImage ramp = Ramp(61, 0.01f, 0.0f);
  for (const auto& [orientation, direction] :
       {std::pair(0.0, 0), std::pair(M_PI / 2.0, 2), std::pair(M_PI, 4)}) {
    const auto descriptor = SiftDescriptor(ramp, frame, orientation);
    double squared_norm = 0.0;
    for (size_t i = 0; i < descriptor.size(); ++i) {
      squared_norm += descriptor[i] * descriptor[i];
      if (static_cast<int>(i % 8) == direction) {
        EXPECT_GT(descriptor[i], 0.05f);
      } else {
        EXPECT_LT(descriptor[i], 0.01f);
      }
    }
    EXPECT_NEAR(squared_norm, 1.0, 1e-5);
    // The window is symmetric.
    EXPECT_NEAR(descriptor[direction], descriptor[8 * 15 + direction], 1e-3f);
    EXPECT_GT(descriptor[8 * 5 + direction], descriptor[direction]);
  }
}

TEST(SiftDescriptor, IsZeroWithoutGradient) {
  for (const float value :
       SiftDescriptor(Ramp(61, 0.0f, 0.0f), {30.0, 30.0, 2.0}, 0.3)) {
    EXPECT_EQ(value, 0.0f);
  }
}

TEST(ExtractSift, NothingInSmallOrEvenImages) {
  EXPECT_TRUE(ExtractSift({}, FloatImage()).keypoints.empty());
  EXPECT_TRUE(ExtractSift({}, FloatImage(1, 1)).keypoints.empty());
  EXPECT_TRUE(ExtractSift({}, FloatImage(2, 9)).keypoints.empty());
  EXPECT_TRUE(ExtractSift({}, FloatImage(64, 48)).keypoints.empty());
  SiftOptions coarse;
  coarse.first_octave = 5;
  EXPECT_TRUE(ExtractSift(coarse, FloatImage(64, 48)).keypoints.empty());
}

}  // namespace
}  // namespace mfir
