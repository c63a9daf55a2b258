#include "colmap_ext/feature/onnx_feature_source.h"

#include <random>

#include <gtest/gtest.h>

#include "tests/support/feature_images.h"
#include "tests/support/onnx_builder.h"
#include "tests/support/test_files.h"

namespace mfir {
namespace {

std::vector<float> RandomWeights(size_t count, int seed) {
  std::mt19937 random(seed);
  std::normal_distribution<float> normal(0.0f, 0.2f);
  std::vector<float> weights(count);
  for (float& weight : weights) weight = normal(random);
  return weights;
}

// One output channel per input channel: the mean of its stride x stride pixels.
std::string MeanNetwork(int num_channels, int stride) {
  std::vector<float> weights(num_channels * num_channels * stride * stride,
                             0.0f);
  for (int c = 0; c < num_channels; ++c) {
    for (int k = 0; k < stride * stride; ++k) {
      weights[(c * num_channels + c) * stride * stride + k] =
          1.0f / (stride * stride);
    }
  }
  OnnxBuilder builder(num_channels);
  builder.Conv(
      "image", "map", num_channels, num_channels, stride, stride, 0, weights);
  builder.Output("map", num_channels);
  return builder.Str();
}

// Two layers, 6 channels, receptive field of 5 pixels around the centre.
std::string DeepNetwork(int size = 0) {
  OnnxBuilder builder(3, size);
  builder.Conv("image", "hidden", 3, 4, 7, 1, 3, RandomWeights(4 * 3 * 49, 1));
  builder.Conv("hidden", "map", 4, 6, 5, 1, 2, RandomWeights(6 * 4 * 25, 2));
  builder.Output("map", 6);
  return builder.Str();
}

class OnnxFeatureSourceTest : public testing::Test {
 protected:
  OnnxFeatureSourceTest() {
    options_.path = folder_ / "network.onnx";
    options_.l2_normalize = false;
  }

  DenseFeaturePatches Extract(const TestImage& image,
                              const Keypoints& keypoints,
                              int patch_size = 8) {
    image.Write(folder_ / "image.png");
    return MakeOnnxFeatureSource(options_, patch_size, 2, folder_.Path())
        ->Extract(image.Request("image.png", keypoints));
  }

  template <typename ErrorType = InputError>
  void ExpectRefused(const std::vector<std::string>& parts) {
    try {
      MakeOnnxFeatureSource(options_, 8, 1, folder_.Path());
      ADD_FAILURE() << "no error: " << testing::PrintToString(parts);
    } catch (const ErrorType& error) {
      for (const std::string& part : parts) {
        EXPECT_NE(std::string(error.what()).find(part), std::string::npos)
            << error.what();
      }
    }
  }

  const TemporaryFolder folder_;
  OnnxFeatureOptions options_;
};

// Every feature is the mean over the image pixels that its pixel of the map
// stands for.
TEST_F(OnnxFeatureSourceTest, PixelsOfTheMapLieWhereTheyAreSaidToLie) {
  const TestImage image = TestImage::Texture(150, 97, 0.0, 0.0, 3);
  const Keypoints keypoints = {
      {70.3, 40.8}, {0.0, 0.0}, {150.0, 97.0}, {149.0, 2.0}};
  for (const int stride : {1, 2, 4}) {
    WriteFile(options_.path, MeanNetwork(3, stride));
    for (const int tile_size : {64, 96, 1024}) {
      options_.tile_size = tile_size;
      options_.tile_overlap = 0;
      options_.tile_alignment = 4;
      const DenseFeaturePatches patches = Extract(image, keypoints);
      EXPECT_EQ(patches.pixel_size, stride);
      EXPECT_EQ(patches.num_channels, 3);
      for (size_t i = 0; i < keypoints.size(); ++i) {
        ASSERT_TRUE(patches.valid[i]);
        const Eigen::Vector2i corner = patches.corners[i];
        EXPECT_GE(corner.minCoeff(), 0);
        EXPECT_LE((corner.x() + 8) * stride, 150);
        EXPECT_LE((corner.y() + 8) * stride, 97);
        for (const auto& [column, row] : {std::pair(0, 0), {7, 3}, {4, 7}}) {
          const std::vector<float> feature =
              Descriptor(patches, i, column, row);
          for (int c = 0; c < 3; ++c) {
            double mean = 0.0;
            for (int k = 0; k < stride * stride; ++k) {
              mean += image.Pixel((corner.x() + column) * stride + k % stride,
                                  (corner.y() + row) * stride + k / stride,
                                  c);
            }
            EXPECT_NEAR(feature[c], mean / (255.0 * stride * stride), 1e-3);
          }
        }
      }
    }
  }
}

TEST_F(OnnxFeatureSourceTest, TilesGiveWhatTheWholeImageGives) {
  WriteFile(options_.path, DeepNetwork());
  const TestImage image = TestImage::Texture(411, 257, 0.0, 0.0, 3);
  Keypoints keypoints;
  for (int i = 0; i < 300; ++i) {
    keypoints.emplace_back(std::fmod(61.7 * i, 411.0),
                           std::fmod(37.3 * i, 257.0));
  }
  options_.tile_size = 1024;
  const DenseFeaturePatches whole = Extract(image, keypoints);
  const auto max_difference = [&](const DenseFeaturePatches& tiled) {
    EXPECT_EQ(whole.corners, tiled.corners);
    double max = 0.0;
    for (size_t k = 0; k < whole.data.size(); ++k) {
      const auto value = [k](const DenseFeaturePatches& patches) {
        return static_cast<float>(
            Eigen::numext::bit_cast<Eigen::half>(patches.data[k]));
      };
      max = std::max<double>(max, std::abs(value(whole) - value(tiled)));
    }
    return max;
  };
  options_.tile_size = 96;
  options_.tile_alignment = 8;
  options_.tile_overlap = 5;
  EXPECT_LT(max_difference(Extract(image, keypoints)), 2e-3);
  // The option does reach the tiles: too little overlap shows.
  options_.tile_overlap = 2;
  EXPECT_GT(max_difference(Extract(image, keypoints)), 2e-2);
}

TEST_F(OnnxFeatureSourceTest, NetworksForOneInputSize) {
  for (const int width : {50, 96, 250}) {
    const TestImage image = TestImage::Texture(width, 64, 0.0, 0.0, 3);
    const Keypoints keypoints = {{20.0, 60.0}, {width - 1.0, 30.0}};
    options_ = {};
    options_.path = folder_ / "any.onnx";
    WriteFile(options_.path, DeepNetwork());
    const DenseFeaturePatches expected = Extract(image, keypoints);
    options_.path = folder_ / "fixed.onnx";
    WriteFile(options_.path, DeepNetwork(96));
    options_.fixed_size = true;
    options_.tile_size = 96;
    options_.tile_overlap = 5;
    options_.tile_alignment = 8;
    const DenseFeaturePatches patches = Extract(image, keypoints);
    for (size_t i = 0; i < keypoints.size(); ++i) {
      EXPECT_EQ(patches.corners[i], expected.corners[i]);
      EXPECT_LT(DescriptorDistance(Descriptor(patches, i, 1, 1),
                                   Descriptor(expected, i, 1, 1)),
                1e-3);
    }
  }
}

TEST_F(OnnxFeatureSourceTest, ColorsAndNormalization) {
  WriteFile(options_.path, MeanNetwork(3, 1));
  TestImage image = TestImage::Texture(64, 64, 0.0, 0.0, 3);
  for (int c = 0; c < 3; ++c) {
    for (int y = 0; y < 64; ++y) {
      for (int x = 0; x < 64; ++x) image.Pixel(x, y, c) = 51 * (c + 1);
    }
  }
  const auto expect = [&](const std::vector<float>& expected) {
    const std::vector<float> feature =
        Descriptor(Extract(image, {{30.0, 30.0}}), 0, 4, 4);
    ASSERT_EQ(feature.size(), expected.size());
    for (size_t c = 0; c < expected.size(); ++c) {
      EXPECT_NEAR(feature[c], expected[c], 1e-3);
    }
  };
  expect({0.2f, 0.4f, 0.6f});
  options_.color_order = "bgr";
  expect({0.6f, 0.4f, 0.2f});
  options_.mean = "0.1,0.2,0.3";
  options_.std = "0.5";
  expect({1.0f, 0.4f, -0.2f});
  options_.color_order = "rgb";
  options_.std = "0.5,1,2";
  expect({0.2f, 0.2f, 0.15f});
  options_.l2_normalize = true;
  const float norm = std::sqrt(2 * 0.04f + 0.0225f);
  expect({0.2f / norm, 0.2f / norm, 0.15f / norm});
  options_.l2_normalize = false;
  options_.color_order = "grey";
  options_.mean = "0";
  options_.std = "1";
  WriteFile(options_.path, MeanNetwork(1, 1));
  // COLMAP's weights of red, green and blue.
  expect({0.2126f * 0.2f + 0.7152f * 0.4f + 0.0722f * 0.6f});
}

TEST_F(OnnxFeatureSourceTest, NamesOfOutputs) {
  OnnxBuilder builder(3);
  builder.Conv("image", "first", 3, 2, 1, 1, 0, {1, 0, 0, 0, 1, 0});
  builder.Conv("image", "second", 3, 1, 1, 1, 0, {0, 0, 1});
  builder.Output("first", 2);
  builder.Output("second", 1);
  WriteFile(options_.path, builder.Str());
  ExpectRefused<UsageError>({"several outputs", "onnx_output"});
  const TestImage image = TestImage::Texture(64, 64, 0.0, 0.0, 3);
  options_.output_name = "first";
  EXPECT_EQ(Extract(image, {{30.0, 30.0}}).num_channels, 2);
  options_.output_name = "second";
  EXPECT_EQ(Extract(image, {{30.0, 30.0}}).num_channels, 1);
  options_.input_name = "image";
  EXPECT_EQ(Extract(image, {{30.0, 30.0}}).num_channels, 1);
  options_.input_name = "photo";
  ExpectRefused({"onnx_input"});
  options_.input_name = "";
  options_.output_name = "third";
  ExpectRefused({"onnx_output"});
}

TEST_F(OnnxFeatureSourceTest, NetworksThatDoNotFit) {
  ExpectRefused({options_.path, "no such file"});
  WriteFile(options_.path, "not a network");
  ExpectRefused({options_.path, "cannot read the network"});
  WriteFile(options_.path, "");
  ExpectRefused({options_.path, "cannot read the network"});
  WriteFile(options_.path, MeanNetwork(1, 1));
  ExpectRefused({"onnx_color_order"});
  options_.color_order = "grey";
  MakeOnnxFeatureSource(options_, 8, 1, folder_.Path());
  options_.color_order = "rgb";
  // Without padding the map is smaller than the image.
  OnnxBuilder builder(3);
  builder.Conv("image", "map", 3, 2, 5, 1, 0, RandomWeights(2 * 3 * 25, 1));
  builder.Output("map", 2);
  WriteFile(options_.path, builder.Str());
  ExpectRefused({"no stride", "pad"});
  WriteFile(options_.path, MeanNetwork(3, 2));
  options_.stride = 2;
  MakeOnnxFeatureSource(options_, 8, 1, folder_.Path());
  options_.stride = 4;
  ExpectRefused({"no stride of 4", "onnx_stride"});
  options_.stride = 0;
  options_.tile_alignment = 1;
  ExpectRefused<UsageError>({"onnx_tile_alignment", "multiple"});
}

TEST_F(OnnxFeatureSourceTest, FeaturesThatAreNotFinite) {
  WriteFile(options_.path, MeanNetwork(3, 1));
  options_.std = "1e-6";
  const DenseFeaturePatches patches = Extract(
      TestImage::Texture(64, 64, 0.0, 0.0, 3), {{30.0, 30.0}, {10.0, 9.0}});
  EXPECT_EQ(patches.valid, std::vector<bool>(2, false));
  for (const uint16_t value : patches.data) ASSERT_EQ(value, 0);
}

}  // namespace
}  // namespace mfir
