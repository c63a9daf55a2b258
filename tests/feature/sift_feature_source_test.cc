#include "colmap_ext/feature/sift_feature_source.h"

#include <cmath>

#include <gtest/gtest.h>

#include "src/util/random.h"
#include "tests/support/feature_images.h"
#include "tests/support/serial_sift.h"
#include "tests/support/test_files.h"

namespace mfir {
namespace {

DenseFeaturePatches Extract(const TestImage& image,
                            const Keypoints& keypoints,
                            const SiftFeatureOptions& options = {},
                            int patch_size = 16,
                            int num_threads = 1) {
  const TemporaryFolder folder;
  image.Write(folder / "image.png");
  SiftFeatureSource source(options, patch_size, num_threads, folder.Path());
  return source.Extract(image.Request("image.png", keypoints));
}

// A blob looks the same from all sides: descriptors at points mirrored about
// its centre are mirrored descriptors. Here their sums over mirrored halves of
// the spatial bins are balanced at the centre alone.
double Imbalance(const std::vector<float>& descriptor, int axis) {
  double sum = 0.0;
  for (int bin = 0; bin < 16; ++bin) {
    const double side = (axis == 0 ? bin % 4 : bin / 4) - 1.5;
    for (int orientation = 0; orientation < 8; ++orientation) {
      sum += side * std::pow(descriptor[bin * 8 + orientation], 2);
    }
  }
  return sum;
}

// Coordinate (feature pixels, of the patch) where the imbalance crosses zero
// next to the keypoint.
double ZeroCrossing(const DenseFeaturePatches& patches, int axis, int middle) {
  for (int i = middle - 2; i < middle + 2; ++i) {
    const auto at = [&](int index) {
      return Imbalance(axis == 0 ? Descriptor(patches, 0, index, middle)
                                 : Descriptor(patches, 0, middle, index),
                       axis);
    };
    const double a = at(i);
    const double b = at(i + 1);
    if ((a > 0.0) != (b > 0.0)) {
      return i + a / (a - b) + 0.5;
    }
  }
  return std::nan("");
}

TEST(SiftFeatureSource, PixelCentresAreExact) {
  for (const int bin_size : {2, 4, 6, 8}) {
    SiftFeatureOptions options;
    options.bin_size = bin_size;
    for (const Eigen::Vector2d& center : {Eigen::Vector2d(40.5, 41.5),
                                          Eigen::Vector2d(40.25, 41.0),
                                          Eigen::Vector2d(40.9, 40.6)}) {
      const TestImage image = TestImage::Blob(96, 80, center, 0.75 * bin_size);
      const DenseFeaturePatches patches = Extract(image, {center}, options);
      ASSERT_TRUE(patches.valid[0]);
      for (const int axis : {0, 1}) {
        const double coordinate =
            patches.corners[0][axis] + ZeroCrossing(patches, axis, 8);
        EXPECT_NEAR(coordinate, center[axis], 0.06)
            << "bin size " << bin_size << ", axis " << axis;
      }
    }
  }
}

TEST(SiftFeatureSource, DescriptorsHaveUnitLength) {
  const TestImage image = TestImage::Texture(120, 100, 0.0, 0.0);
  const DenseFeaturePatches patches =
      Extract(image, {{60.0, 50.0}, {0.0, 0.0}, {120.0, 100.0}});
  EXPECT_EQ(patches.patch_size, 16);
  EXPECT_EQ(patches.num_channels, 128);
  EXPECT_EQ(patches.pixel_size, 1.0);
  ASSERT_EQ(patches.data.size(), 3u * 16 * 16 * 128);
  for (size_t i = 0; i < 3; ++i) {
    ASSERT_TRUE(patches.valid[i]);
    for (int row = 0; row < 16; ++row) {
      for (int column = 0; column < 16; ++column) {
        double squared = 0.0;
        for (const float value : Descriptor(patches, i, column, row)) {
          EXPECT_GE(value, 0.0f);
          squared += value * value;
        }
        EXPECT_NEAR(squared, 1.0, 2e-3);
      }
    }
  }
}

// Whatever the neighbours are that are computed with it, and wherever the patch
// is cut out, a pixel has one descriptor.
TEST(SiftFeatureSource, DescriptorsDoNotDependOnTheOtherPatches) {
  const TestImage image = TestImage::Texture(150, 120, 0.0, 0.0);
  Keypoints keypoints;
  for (int i = 0; i < 60; ++i) {
    keypoints.emplace_back(std::fmod(17.3 * i, 150.0),
                           std::fmod(11.7 * i, 120.0));
  }
  const DenseFeaturePatches all = Extract(image, keypoints, {}, 16, 2);
  for (size_t i = 0; i < keypoints.size(); ++i) {
    const DenseFeaturePatches one = Extract(image, {keypoints[i]});
    ASSERT_EQ(all.corners[i], one.corners[0]);
    for (int row = 0; row < 16; ++row) {
      for (int column = 0; column < 16; ++column) {
        EXPECT_LT(DescriptorDistance(Descriptor(all, i, column, row),
                                     Descriptor(one, 0, column, row)),
                  2e-3);
      }
    }
  }
}

// The same texture one pixel further: the same descriptors one pixel further,
// also next to the border, where patches are moved inside.
TEST(SiftFeatureSource, PatchesAtBordersAreComplete) {
  const TestImage image = TestImage::Texture(100, 90, 0.0, 0.0);
  const Keypoints keypoints = {
      {0.0, 0.0}, {100.0, 90.0}, {3.2, 45.0}, {99.9, 0.1}, {50.0, 89.0}};
  const std::vector<Eigen::Vector2i> corners = {
      {0, 0}, {84, 74}, {0, 37}, {84, 0}, {42, 74}};
  const DenseFeaturePatches patches = Extract(image, keypoints);
  for (size_t i = 0; i < keypoints.size(); ++i) {
    ASSERT_TRUE(patches.valid[i]);
    EXPECT_EQ(patches.corners[i], corners[i]);
    // A patch whose middle lies elsewhere sees the same pixels.
    const Eigen::Vector2d middle =
        corners[i].cast<double>() + Eigen::Vector2d(8.0, 8.0);
    const DenseFeaturePatches same = Extract(image, {middle});
    for (int k = 0; k < 16; ++k) {
      EXPECT_LT(DescriptorDistance(Descriptor(patches, i, k, 15 - k),
                                   Descriptor(same, 0, k, 15 - k)),
                1e-3);
    }
  }
}

// Largest difference of an element of the descriptors of VLFeat and of the
// functions of the CUDA kernels.
float MaxDifferenceFromKernels(const TestImage& image,
                               const SiftFeatureOptions& options) {
  const TemporaryFolder folder;
  image.Write(folder / "image.png");
  SiftFeatureSource source(options, 16, 1, folder.Path());
  Keypoints keypoints = {
      {0.0, 0.0}, {image.width + 0.0, image.height + 0.0}, {-1.0, 5.0}};
  for (int i = 0; i < 20; ++i) {
    keypoints.emplace_back(std::fmod(17.3 * i, image.width),
                           std::fmod(11.7 * i, image.height));
  }
  const DenseFeatureRequest request = image.Request("image.png", keypoints);
  const DenseFeaturePatches expected = source.Extract(request);
  SiftImage sift_image;
  DenseFeaturePatches places;
  EXPECT_TRUE(source.ReadSiftImage(request, &sift_image, &places));
  EXPECT_EQ(places.corners, expected.corners);
  EXPECT_EQ(places.valid, expected.valid);
  EXPECT_EQ(places.patch_size, expected.patch_size);
  EXPECT_TRUE(places.data.empty());
  std::vector<SiftCorner> corners;
  for (const Eigen::Vector2i& corner : places.corners) {
    corners.push_back({corner.x(), corner.y()});
  }
  const std::vector<uint16_t> patches =
      SerialSiftPatches(sift_image, corners, 16);
  EXPECT_EQ(patches.size(), expected.data.size());
  float max_difference = 0.0f;
  for (size_t i = 0; i < patches.size(); ++i) {
    if (!places.valid[i / places.PatchNumElements()]) continue;
    max_difference = std::max(
        max_difference,
        std::abs(HalfToFloat(patches[i]) - HalfToFloat(expected.data[i])));
  }
  return max_difference;
}

TEST(SiftFeatureSource, EqualsTheKernelsOfTheGpu) {
  Random random({9});
  TestImage noise = TestImage::Constant(110, 90, 0);
  for (uint8_t& value : noise.values) {
    value = static_cast<uint8_t>(random.Uniform(0.0, 255.99));
  }
  for (const int bin_size : {2, 4, 6, 16}) {
    for (const double smoothing : {0.0, 1.0}) {
      SiftFeatureOptions options;
      options.bin_size = bin_size;
      options.smoothing = smoothing;
      for (const TestImage& image :
           {noise, TestImage::Texture(110, 90, 0.0, 0.0)}) {
        // Half a unit in the last place of fp16 is 1.2e-4 above 0.25, and
        // rounding errors of VLFeat's running sums show in small elements.
        EXPECT_LT(MaxDifferenceFromKernels(image, options), 3e-4f)
            << "bin size " << bin_size << ", smoothing " << smoothing;
      }
    }
  }
}

TEST(SiftFeatureSource, KeypointsOutsideAreNotValid) {
  const TestImage image = TestImage::Texture(60, 50, 0.0, 0.0);
  const double nan = std::nan("");
  const DenseFeaturePatches patches = Extract(
      image,
      {{-0.1, 20.0}, {20.0, 50.1}, {nan, 20.0}, {1e300, 1e300}, {30.0, 25.0}});
  EXPECT_EQ(patches.valid,
            std::vector<bool>({false, false, false, false, true}));
  for (size_t i = 0; i < 4 * patches.PatchNumElements(); ++i) {
    ASSERT_EQ(patches.data[i], 0);
  }
}

TEST(SiftFeatureSource, ConstantImagesGiveZeros) {
  const DenseFeaturePatches constant =
      Extract(TestImage::Constant(64, 64, 130), {{30.0, 30.0}});
  for (const uint16_t value : constant.data) ASSERT_EQ(value, 0);
  // Texture far above: what running sums leave of it must not show.
  TestImage half = TestImage::Texture(64, 128, 0.0, 0.0);
  for (int y = 40; y < 128; ++y) {
    for (int x = 0; x < 64; ++x) half.Pixel(x, y) = 100;
  }
  const DenseFeaturePatches below = Extract(half, {{32.0, 90.0}, {20.0, 68.0}});
  for (const uint16_t value : below.data) ASSERT_EQ(value, 0);
}

TEST(SiftFeatureSource, OptionsReachTheDescriptors) {
  const TestImage image = TestImage::Texture(90, 90, 0.0, 0.0);
  const Keypoints keypoints = {{45.0, 45.0}};
  const auto default_descriptor =
      Descriptor(Extract(image, keypoints), 0, 8, 8);
  SiftFeatureOptions options;
  options.bin_size = 6;
  EXPECT_GT(DescriptorDistance(
                Descriptor(Extract(image, keypoints, options), 0, 8, 8),
                default_descriptor),
            0.05);
  options = {};
  options.smoothing = 3.0;
  EXPECT_GT(DescriptorDistance(
                Descriptor(Extract(image, keypoints, options), 0, 8, 8),
                default_descriptor),
            0.05);
  const DenseFeaturePatches small = Extract(image, keypoints, {}, 9);
  EXPECT_EQ(small.patch_size, 9);
  EXPECT_EQ(small.corners[0], Eigen::Vector2i(41, 41));
  EXPECT_LT(DescriptorDistance(Descriptor(small, 0, 4, 4),
                               Descriptor(Extract(image, keypoints), 0, 8, 8)),
            1e-3);
}

TEST(SiftFeatureSource, ImagesThatDoNotFit) {
  const TemporaryFolder folder;
  const TestImage image = TestImage::Texture(40, 40, 0.0, 0.0);
  image.Write(folder / "image.png");
  SiftFeatureSource source({}, 16, 1, folder.Path());
  DenseFeatureRequest request = image.Request("image.png", {{20.0, 20.0}});
  request.width = 80;
  ExpectInputError([&] { source.Extract(request); },
                   {"image.png", "40 x 40", "80 x 40"});
  WriteFile(folder / "broken.png", "no image");
  request = image.Request("broken.png", {{20.0, 20.0}});
  ExpectInputError([&] { source.Extract(request); },
                   {"broken.png", "not a readable image"});
  SiftFeatureSource large({}, 64, 1, folder.Path());
  request = image.Request("image.png", {{20.0, 20.0}});
  ExpectInputError([&] { large.Extract(request); }, {"feature_patch_size"});
  request = image.Request("missing.png", {{20.0, 20.0}});
  const DenseFeaturePatches patches = source.Extract(request);
  EXPECT_EQ(patches.valid, std::vector<bool>({false}));
  EXPECT_TRUE(patches.data.empty());
  SiftImage sift_image;
  DenseFeaturePatches places;
  EXPECT_TRUE(source.ReadSiftImage(request, &sift_image, &places));
  EXPECT_EQ(places.valid, std::vector<bool>({false}));
}

}  // namespace
}  // namespace mfir
