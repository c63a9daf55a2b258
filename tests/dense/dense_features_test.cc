// Placement of patches, tiles, and the options of dense features.

#include "src/dense/dense_features.h"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>

#include "src/feature/image_tiles.h"
#include "src/refinement/options.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

DenseFeatureRequest Request(int width, int height, const Keypoints& keypoints) {
  DenseFeatureRequest request;
  request.width = width;
  request.height = height;
  request.keypoints = keypoints;
  request.keypoint_ids.resize(keypoints.size());
  return request;
}

// The keypoint is within half a feature pixel of the patch's centre.
TEST(PlacePatches, KeypointsLieInTheMiddle) {
  Keypoints keypoints;
  for (int i = 0; i < 100; ++i) {
    keypoints.emplace_back(200.0 + 0.13 * i, 150.0 - 0.07 * i);
  }
  for (const double pixel_size : {1.0, 2.0, 4.0}) {
    for (const int patch_size : {4, 7, 16}) {
      const DenseFeaturePatches patches =
          PlacePatches(Request(640, 480, keypoints), patch_size, 3, pixel_size);
      EXPECT_EQ(patches.pixel_size, pixel_size);
      EXPECT_EQ(patches.data.size(), 100u * patch_size * patch_size * 3);
      for (size_t i = 0; i < keypoints.size(); ++i) {
        ASSERT_TRUE(patches.valid[i]);
        const Eigen::Vector2d middle =
            (patches.corners[i].cast<double>() +
             Eigen::Vector2d::Constant(0.5 * patch_size)) *
            pixel_size;
        EXPECT_LE((middle - keypoints[i]).cwiseAbs().maxCoeff(),
                  0.5 * pixel_size + 1e-9);
      }
    }
  }
}

TEST(PlacePatches, MovedInsideAtBorders) {
  const DenseFeaturePatches patches = PlacePatches(
      Request(101, 50, {{0.0, 0.0}, {101.0, 50.0}, {100.0, 3.0}}), 16, 1, 1.0);
  EXPECT_EQ(patches.corners[0], Eigen::Vector2i(0, 0));
  EXPECT_EQ(patches.corners[1], Eigen::Vector2i(85, 34));
  EXPECT_EQ(patches.corners[2], Eigen::Vector2i(85, 0));
  // Half a feature pixel at the end belongs to no patch.
  const DenseFeaturePatches strided =
      PlacePatches(Request(101, 50, {{100.0, 49.0}}), 16, 1, 2.0);
  EXPECT_EQ(strided.corners[0], Eigen::Vector2i(34, 9));
}

TEST(PlacePatches, ImagesSmallerThanAPatch) {
  EXPECT_THROW(PlacePatches(Request(15, 50, {}), 16, 1, 1.0), InputError);
  EXPECT_THROW(PlacePatches(Request(50, 31, {}), 16, 1, 2.0), InputError);
  EXPECT_NO_THROW(PlacePatches(Request(16, 16, {{1.0, 1.0}}), 16, 1, 1.0));
}

TEST(DenseFeatures, ValuesThatAreNotFiniteMakeAPatchInvalid) {
  DenseFeaturePatches patches = PlacePatches(
      Request(32, 32, {{16.0, 16.0}, {16.0, 16.0}, {16.0, 16.0}, {16.0, 16.0}}),
      4,
      2,
      1.0);
  const float largest[] = {65504.0f, -65504.0f};
  const float too_large[] = {0.0f, 1e6f};
  const float nan[] = {std::nanf(""), 0.0f};
  SetDescriptor(largest, 0, 3, 3, &patches);
  SetDescriptor(too_large, 1, 0, 0, &patches);
  SetDescriptor(nan, 2, 1, 2, &patches);
  InvalidateNonFinite(&patches);
  EXPECT_EQ(patches.valid, std::vector<bool>({true, false, false, true}));
  EXPECT_EQ(patches.data[31], 0xFBFF);
  EXPECT_EQ(patches.data[30], 0x7BFF);
  for (size_t i = 32; i < patches.data.size(); ++i) {
    EXPECT_EQ(patches.data[i], 0);
  }
}

// All that PlanTiles promises, for many sizes.
TEST(PlanTiles, TilesCoverTheImageWithMargins) {
  for (const auto& [alignment, fixed_size] :
       {std::pair(1, false), {8, false}, {32, false}, {8, true}}) {
    for (const int margin : {0, 5, 40}) {
      for (int size = 20; size < 1500; size += 13) {
        const int max_size = 192;
        const TilesAlongAxis tiles =
            PlanTiles(size, max_size, margin, alignment, fixed_size);
        ASSERT_LE(tiles.size, max_size);
        if (fixed_size) {
          ASSERT_EQ(tiles.size, max_size);
        }
        ASSERT_EQ(tiles.size % alignment, 0);
        ASSERT_EQ(tiles.cores.front(), 0);
        ASSERT_EQ(tiles.cores.back(), size);
        for (size_t k = 0; k < tiles.begins.size(); ++k) {
          const int begin = tiles.begins[k];
          ASSERT_EQ(begin % alignment, 0);
          ASSERT_GE(begin, 0);
          ASSERT_LE(begin, std::max(0, tiles.cores[k] - margin));
          ASSERT_GE(begin + tiles.size,
                    std::min(size, tiles.cores[k + 1] + margin));
          if (!fixed_size || begin > 0) {
            ASSERT_LT(begin + tiles.size, size + alignment);
          }
        }
        for (double x = 0.0; x <= size; x += 7.3) {
          const size_t k = tiles.TileOf(x);
          ASSERT_LE(tiles.cores[k], x);
          ASSERT_GE(tiles.cores[k + 1], x);
        }
      }
    }
  }
}

TEST(PlanTiles, SmallImagesAreOneTile) {
  const TilesAlongAxis tiles = PlanTiles(100, 128, 100, 32);
  EXPECT_EQ(tiles.begins, std::vector<int>({0}));
  EXPECT_EQ(tiles.size, 128);
}

TEST(PlanTiles, MarginsThatLeaveNoRoom) {
  EXPECT_THROW(PlanTiles(1000, 128, 60, 32), UsageError);
  EXPECT_THROW(PlanTiles(1000, 128, 48, 32), UsageError);
  EXPECT_NO_THROW(PlanTiles(1000, 128, 47, 32));
}

class FeatureOptionsTest : public testing::Test {
 protected:
  void ExpectRefused(const std::string& name) {
    try {
      options_.Check();
      ADD_FAILURE() << name << " is not refused";
    } catch (const UsageError& error) {
      EXPECT_NE(std::string(error.what()).find(name), std::string::npos)
          << error.what();
    }
    options_ = {};
  }

  MultiFrameOptions options_;
  DenseFeatureOptions& features_ = options_.features;
};

TEST_F(FeatureOptionsTest, ValuesOutOfRange) {
  EXPECT_NO_THROW(options_.Check());
  features_.patch_size = 3;
  ExpectRefused("feature_patch_size");
  features_.patch_size = 129;
  ExpectRefused("feature_patch_size");
  for (const int bin_size : {0, 1, 3, 5, 66}) {
    features_.sift.bin_size = bin_size;
    ExpectRefused("sift_bin_size");
  }
  for (const double smoothing :
       {-0.1, 101.0, std::numeric_limits<double>::quiet_NaN()}) {
    features_.sift.smoothing = smoothing;
    ExpectRefused("sift_smoothing");
  }
  features_.onnx.color_order = "gbr";
  ExpectRefused("onnx_color_order");
  for (const char* mean : {"", "0.1,", "0.1,0.2", "a", "0.1;0.2;0.3", "nan"}) {
    features_.onnx.mean = mean;
    ExpectRefused("onnx_mean");
  }
  features_.onnx.color_order = "grey";
  features_.onnx.mean = "0.1,0.2,0.3";
  ExpectRefused("onnx_mean");
  for (const char* std : {"0", "1,1,-1", "1,2,3,4"}) {
    features_.onnx.std = std;
    ExpectRefused("onnx_std");
  }
  features_.onnx.stride = -1;
  ExpectRefused("onnx_stride");
  features_.onnx.tile_overlap = -1;
  ExpectRefused("onnx_tile_overlap");
  features_.onnx.tile_alignment = 0;
  ExpectRefused("onnx_tile_alignment");
  features_.onnx.tile_size = 1000;
  ExpectRefused("onnx_tile_size");
  features_.onnx.tile_size = 1 << 20;
  ExpectRefused("onnx_tile_size");
}

TEST_F(FeatureOptionsTest, SourcesNeedTheirFiles) {
  options_.dense_features = "onnx";
  ExpectRefused("onnx_path");
  options_.dense_features = "database";
  ExpectRefused("dense_feature_path");
  options_.dense_features = "none";
  features_.write_path = "features.sqlite";
  ExpectRefused("write_dense_features");
}

TEST_F(FeatureOptionsTest, NumberLists) {
  EXPECT_EQ(ParseNumberList("x", "0.485,-1e-2,3"),
            std::vector<double>({0.485, -0.01, 3.0}));
  EXPECT_EQ(ParseNumberList("x", "1"), std::vector<double>({1.0}));
  EXPECT_THROW(ParseNumberList("x", "1, 2"), UsageError);
}

}  // namespace
}  // namespace mfir
