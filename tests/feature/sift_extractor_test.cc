#include "colmap_ext/feature/sift_extractor.h"

#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "src/util/random.h"
#include "tests/support/feature_images.h"
#include "tests/support/test_files.h"

namespace mfir {
namespace {

struct Features {
  host::FeatureKeypoints keypoints;
  host::FeatureDescriptors descriptors;
};

host::FeatureExtractionOptions CpuOptions() {
  host::FeatureExtractionOptions options;
  options.use_gpu = false;
  return options;
}

Features Extract(const TestImage& image,
                 const host::FeatureExtractionOptions& options,
                 bool with_colmap = false) {
  const TemporaryFolder folder;
  image.Write(folder / "image.png");
  host::Bitmap bitmap;
  EXPECT_TRUE(bitmap.Read(folder / "image.png", /*as_rgb=*/false));
  const auto extractor = with_colmap ? host::FeatureExtractor::Create(options)
                                     : MakeBuiltInSift(options);
  Features features;
  EXPECT_TRUE(
      extractor->Extract(bitmap, &features.keypoints, &features.descriptors));
  EXPECT_EQ(features.descriptors.data.rows(),
            static_cast<Eigen::Index>(features.keypoints.size()));
  EXPECT_EQ(features.descriptors.data.cols(), 128);
  return features;
}

// Blobs of different size and sign at random places.
TestImage RandomBlobs(int width, int height, uint64_t seed) {
  Random random({seed});
  std::vector<double> values(static_cast<size_t>(width) * height, 128.0);
  for (int i = 0; i < width * height / 300; ++i) {
    const Eigen::Vector2d center(random.Uniform(0.0, width),
                                 random.Uniform(0.0, height));
    const double sigma = 1.5 * std::pow(5.0, random.Uniform());
    const double amplitude = random.Uniform(-60.0, 60.0);
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        const double squared =
            (Eigen::Vector2d(x + 0.5, y + 0.5) - center).squaredNorm();
        values[static_cast<size_t>(y) * width + x] +=
            amplitude * std::exp(-0.5 * squared / (sigma * sigma));
      }
    }
  }
  TestImage image = TestImage::Constant(width, height, 0);
  std::transform(
      values.begin(), values.end(), image.values.begin(), [](double value) {
        return static_cast<uint8_t>(std::lround(std::clamp(value, 0.0, 255.0)));
      });
  return image;
}

// Sides that can be halved often, and such that cannot. Blobs of all octaves.
TEST(BuiltInSift, PixelCentresAreExact) {
  for (const auto& [width, height] :
       {std::pair(192, 160), std::pair(203, 151)}) {
    for (const double sigma : {1.5, 3.0, 6.0, 9.0}) {
      for (const Eigen::Vector2d& center : {Eigen::Vector2d(100.5, 80.5),
                                            Eigen::Vector2d(91.8, 73.1),
                                            Eigen::Vector2d(120.25, 66.6)}) {
        const Features features = Extract(
            TestImage::Blob(width, height, center, sigma), CpuOptions());
        ASSERT_FALSE(features.keypoints.empty());
        double smallest = 1e9;
        for (const host::FeatureKeypoint& keypoint : features.keypoints) {
          smallest = std::min(
              smallest,
              (Eigen::Vector2d(keypoint.x, keypoint.y) - center).norm());
        }
        EXPECT_LT(smallest, 0.02 * sigma + 0.01)
            << width << " " << sigma << " " << center.transpose();
      }
    }
  }
}

// The same places, sizes, directions and descriptors as COLMAP's extractor,
// with any of its options.
class AgreesWithColmapTest : public testing::Test {
 protected:
  static void Compare(const TestImage& image,
                      const host::FeatureExtractionOptions& options) {
    const Features ours = Extract(image, options);
    const Features theirs = Extract(image, options, /*with_colmap=*/true);
    ASSERT_GT(theirs.keypoints.size(), 20);
    EXPECT_NEAR(static_cast<double>(ours.keypoints.size()),
                static_cast<double>(theirs.keypoints.size()),
                0.02 * theirs.keypoints.size());
    size_t num_same = 0;
    for (size_t i = 0; i < theirs.keypoints.size(); ++i) {
      for (size_t j = 0; j < ours.keypoints.size(); ++j) {
        if (!IsSame(ours.keypoints[j], theirs.keypoints[i])) continue;
        const double product =
            theirs.descriptors.data.row(i).cast<double>().dot(
                ours.descriptors.data.row(j).cast<double>());
        EXPECT_GT(product / (512.0 * 512.0), 0.98);
        ++num_same;
        break;
      }
    }
    EXPECT_GE(num_same, 0.98 * theirs.keypoints.size());
  }

  static bool IsSame(const host::FeatureKeypoint& a,
                     const host::FeatureKeypoint& b) {
    return std::hypot(a.x - b.x, a.y - b.y) < 0.01 &&
           std::abs(std::log(a.ComputeScale() / b.ComputeScale())) < 0.005 &&
           std::cos(a.ComputeOrientation() - b.ComputeOrientation()) > 0.9995;
  }
};

TEST_F(AgreesWithColmapTest, WithItsDefaults) {
  Compare(RandomBlobs(301, 223, 3), CpuOptions());
}

TEST_F(AgreesWithColmapTest, WithOtherOptions) {
  const TestImage image = RandomBlobs(252, 203, 4);
  const auto compare = [&image](const auto& change) {
    host::FeatureExtractionOptions options = CpuOptions();
    change(&host::SiftExtraction(options));
    Compare(image, options);
  };
  compare([](auto* sift) { sift->first_octave = 0; });
  compare([](auto* sift) { sift->first_octave = -2; });
  compare([](auto* sift) { sift->num_octaves = 2; });
  compare([](auto* sift) { sift->octave_resolution = 4; });
  compare([](auto* sift) { sift->max_num_features = 60; });
  compare([](auto* sift) { sift->max_num_orientations = 1; });
  compare([](auto* sift) { sift->upright = true; });
  compare([](auto* sift) { sift->edge_threshold = 4.0; });
  compare([](auto* sift) { sift->peak_threshold *= 3.0; });
  compare([](auto* sift) {
    sift->normalization = host::SiftExtractionOptions::Normalization::L2;
  });
}

TEST(BuiltInSift, LeavesToColmapWhatItCannotDo) {
  EXPECT_TRUE(BuiltInSiftSupports(CpuOptions()));
  const auto supports = [](const auto& change) {
    host::FeatureExtractionOptions options = CpuOptions();
    change(&options);
    return BuiltInSiftSupports(options);
  };
  EXPECT_FALSE(supports([](auto* options) { options->use_gpu = true; }));
  EXPECT_FALSE(supports(
      [](auto* options) { host::SiftExtraction(*options).first_octave = 0; }));
  EXPECT_FALSE(supports(
      [](auto* options) { host::SiftExtraction(*options).upright = true; }));
  EXPECT_FALSE(supports([](auto* options) {
    host::SiftExtraction(*options).estimate_affine_shape = true;
  }));
  EXPECT_FALSE(supports([](auto* options) {
    host::SiftExtraction(*options).domain_size_pooling = true;
  }));
}

TEST(BuiltInSift, ImagesWithoutTextureHaveNoFeatures) {
  EXPECT_TRUE(Extract(TestImage::Constant(64, 48, 100), CpuOptions())
                  .keypoints.empty());
  EXPECT_TRUE(
      Extract(TestImage::Constant(1, 1, 100), CpuOptions()).keypoints.empty());
}

}  // namespace
}  // namespace mfir
