// The functions of the CUDA kernels of dense SIFT, executed on the CPU. That
// they agree with VLFeat is in tests/feature/sift_feature_source_test.cc.

#include "src/dense/dense_sift_kernels.h"

#include <cmath>

#include <gtest/gtest.h>

#include "cuda/cost_maps_gpu.h"
#include "src/util/gpu_choice.h"
#include "src/util/random.h"
#include "tests/support/serial_sift.h"
#include "tests/support/thread_block.h"

namespace mfir {
namespace {

SiftImage NoiseImage(int width, int height, int bin_size) {
  Random random({5});
  SiftImage image{width, height, bin_size, {}};
  for (int i = 0; i < width * height; ++i) {
    image.grey.push_back(static_cast<float>(random.Uniform(0.0, 255.0)));
  }
  return image;
}

// A plane that rises in direction `angle` (radians) by `slope` per px.
SiftImage PlaneImage(double angle, double slope) {
  SiftImage image{80, 70, 4, {}};
  for (int y = 0; y < image.height; ++y) {
    for (int x = 0; x < image.width; ++x) {
      image.grey.push_back(static_cast<float>(
          slope * (x * std::cos(angle) + y * std::sin(angle))));
    }
  }
  return image;
}

std::vector<float> DescriptorAt(const SiftImage& image, int x, int y) {
  const std::vector<float> bins = SerialSiftBins(image);
  const auto channels =
      ComputeSiftDescriptor(SerialGroup(), LayoutOf(image), bins.data(), x, y);
  return {channels.values, channels.values + kNumSiftChannels};
}

TEST(DenseSiftKernels, Atan2IsApproximate) {
  for (int i = -50; i < 50; ++i) {
    const double angle = M_PI * (i + 0.5) / 50.0;
    EXPECT_NEAR(ApproximateAtan2(static_cast<float>(3.0 * std::sin(angle)),
                                 static_cast<float>(3.0 * std::cos(angle))),
                angle,
                0.0062);
  }
}

// By hand: all gradients are the same, so that the bins of an orientation
// differ by the Gaussian window alone, and there are none of the others.
TEST(DenseSiftKernels, Planes) {
  for (int orientation = 0; orientation < 8; ++orientation) {
    for (const double between : {0.0, 0.5}) {
      const double angle = M_PI / 4.0 * (orientation + between);
      const std::vector<float> descriptor =
          DescriptorAt(PlaneImage(angle, 2.0), 40, 35);
      double sum = 0.0;
      for (int bin = 0; bin < 16; ++bin) {
        for (int k = 0; k < 8; ++k) {
          const double value = std::pow(descriptor[bin * 8 + k], 2);
          sum += value;
          const int offset = (k - orientation + 8) % 8;
          if (offset > (between > 0.0 ? 1 : 0)) {
            EXPECT_NEAR(value, 0.0, 1e-3);
          } else if (between > 0.0) {
            EXPECT_NEAR(value, 1.0 / 32.0, 0.012);
          } else {
            EXPECT_NEAR(value, 1.0 / 16.0, 0.012);
          }
        }
      }
      EXPECT_NEAR(sum, 1.0, 1e-5);
    }
  }
}

TEST(DenseSiftKernels, WindowAndBound) {
  const SiftLayout layout = MakeSiftLayout(80, 70, 4);
  // Means of exp(-z^2 / 2) over the 7 pixels around 6 and 2, z = x / 8.
  EXPECT_NEAR(layout.bin_weights[0], 0.7445, 1e-4);
  EXPECT_NEAR(layout.bin_weights[1], 0.9415, 1e-4);
  EXPECT_EQ(layout.bin_weights[2], layout.bin_weights[1]);
  EXPECT_EQ(layout.bin_weights[3], layout.bin_weights[0]);
  // Of the 16 values of a plane only those of the corner bins stay below 0.2 of
  // the length.
  const std::vector<float> descriptor =
      DescriptorAt(PlaneImage(0.0, 2.0), 40, 35);
  const double outer = layout.bin_weights[0] * layout.bin_weights[0];
  const double edge = layout.bin_weights[0] * layout.bin_weights[1];
  const double inner = layout.bin_weights[1] * layout.bin_weights[1];
  const double bound =
      0.2 *
      std::sqrt(4.0 * (outer * outer + 2.0 * edge * edge + inner * inner));
  ASSERT_LT(outer, bound);
  ASSERT_LT(bound, edge);
  EXPECT_NEAR(std::pow(descriptor[0] / descriptor[8], 2), outer / bound, 1e-2);
  EXPECT_FLOAT_EQ(descriptor[8], descriptor[40]);
}

TEST(DenseSiftKernels, NearlyConstantImagesGiveZeros) {
  // Each bin adds up 4 x 4 gradients; the descriptor is 13 x 13 pixels wide.
  const SiftLayout layout = MakeSiftLayout(80, 70, 4);
  const double sum = 2.0 * (layout.bin_weights[0] + layout.bin_weights[1]);
  const double slope = kMinSiftGradient * 169.0 / (16.0 * sum * sum);
  for (const float value :
       DescriptorAt(PlaneImage(0.3, 0.95 * slope), 40, 35)) {
    EXPECT_EQ(value, 0.0f);
  }
  double squared = 0.0;
  for (const float value :
       DescriptorAt(PlaneImage(0.3, 1.05 * slope), 40, 35)) {
    squared += value * value;
  }
  EXPECT_NEAR(squared, 1.0, 1e-5);
}

// Every number of threads computes the same bits.
TEST(DenseSiftKernels, GridsOfAnySize) {
  const SiftImage image = NoiseImage(37, 29, 6);
  const SiftLayout layout = LayoutOf(image);
  const std::vector<float> expected = SerialSiftBins(image);
  for (const int64_t num_threads : {3, 1000}) {
    std::vector<SiftGradient> gradients(layout.Gradients().NumPixels());
    std::vector<float> row_sums(layout.RowSums().NumPixels() * 8);
    std::vector<float> bins(expected.size());
    for (int64_t i = 0; i < num_threads; ++i) {
      ComputeSiftGradients(
          i, num_threads, layout, image.grey.data(), gradients.data());
    }
    for (int64_t i = 0; i < num_threads; ++i) {
      ComputeSiftRowSums(
          i, num_threads, layout, gradients.data(), row_sums.data());
    }
    for (int64_t i = 0; i < num_threads; ++i) {
      ComputeSiftBins(i, num_threads, layout, row_sums.data(), bins.data());
    }
    EXPECT_EQ(bins, expected);
  }
}

// As in the kernels: several warps share a patch, one has a keypoint.
TEST(DenseSiftKernels, WarpsComputePatchesAndFeatures) {
  constexpr int kNumWarps = 3;
  constexpr int kPatchSize = 4;
  const SiftImage image = NoiseImage(37, 29, 4);
  const SiftLayout layout = LayoutOf(image);
  const std::vector<float> bins = SerialSiftBins(image);
  const SiftCorner corner = {33, 0};
  const std::vector<uint16_t> expected =
      SerialSiftPatches(image, {corner}, kPatchSize);
  std::vector<uint16_t> patch(expected.size(), 0xffff);
  for (int warp = 0; warp < kNumWarps; ++warp) {
    RunBlock<1, GpuLaunch::kWarpSize>([&](const auto& group) {
      ComputeSiftPatch(group,
                       warp,
                       kNumWarps,
                       layout,
                       bins.data(),
                       corner,
                       kPatchSize,
                       patch.data());
    });
  }
  const DenseSiftKeypoint keypoint = {
      corner, {-0.1f, 0.7f, 0.5f, -0.1f}, {-0.05f, 0.25f, 0.9f, -0.1f}};
  std::vector<uint16_t> expected_feature(kNumSiftChannels);
  SerialSift(image).Interpolate({keypoint}, expected_feature.data());
  std::vector<uint16_t> feature(kNumSiftChannels, 0xffff);
  RunBlock<1, GpuLaunch::kWarpSize>([&](const auto& group) {
    InterpolateSiftFeature(
        group, layout, bins.data(), keypoint, feature.data());
  });
  for (size_t i = 0; i < patch.size(); ++i) {
    ASSERT_NEAR(HalfToFloat(patch[i]), HalfToFloat(expected[i]), 3e-4) << i;
  }
  for (size_t c = 0; c < feature.size(); ++c) {
    float sum = 0.0f;
    for (int i = 0; i < 16; ++i) {
      sum += keypoint.row_weights[i / 4] * keypoint.column_weights[i % 4] *
             HalfToFloat(expected[i * kNumSiftChannels + c]);
    }
    EXPECT_NEAR(HalfToFloat(expected_feature[c]), sum, 3e-4);
    EXPECT_NEAR(HalfToFloat(feature[c]), sum, 3e-4);
  }
}

// The twin of the GPU, where there is one.
TEST(DenseSiftGpu, EqualsTheCpu) {
  std::unique_ptr<CostMapBackend> gpu;
  try {
    gpu = CreateGpuCostMapBackend(-1, -1);
  } catch (const GpuError& error) {
    GTEST_SKIP() << "no GPU: " << error.what();
  }
  constexpr size_t kNumPatches = 3000;
  constexpr int kPatchSize = 16;
  Random random({6});
  for (const int bin_size : {4, 12}) {
    const SiftImage image = NoiseImage(300, 200, bin_size);
    std::vector<DenseSiftKeypoint> keypoints;
    for (size_t i = 0; i < kNumPatches; ++i) {
      keypoints.push_back({{static_cast<int>(random.Uniform(0.0, 284.99)),
                            static_cast<int>(random.Uniform(0.0, 184.99))},
                           {-0.1f, 0.7f, 0.5f, -0.1f},
                           {-0.05f, 0.25f, 0.9f, -0.1f}});
    }
    const std::unique_ptr<DeviceSift> sifts[2] = {
        gpu->LoadSift(image), std::make_unique<SerialSift>(image)};
    std::vector<uint16_t> features[2];
    for (int k = 0; k < 2; ++k) {
      features[k].resize(kNumPatches * kNumSiftChannels);
      sifts[k]->Interpolate(keypoints, features[k].data());
    }
    const size_t map_size =
        PatchShape{kPatchSize, kNumSiftChannels}.NumCostElements();
    std::vector<uint16_t> maps[2];
    for (int k = 0; k < 2; ++k) {
      maps[k].resize(kNumPatches * map_size);
      std::vector<SiftMapJob> jobs;
      for (size_t i = 0; i < kNumPatches; ++i) {
        jobs.push_back({keypoints[i].corner,
                        &features[1][(kNumPatches - 1 - i) * kNumSiftChannels],
                        &maps[k][i * map_size]});
      }
      sifts[k]->ComputeMaps(kPatchSize, jobs);
    }
    for (size_t i = 0; i < features[0].size(); ++i) {
      ASSERT_NEAR(
          HalfToFloat(features[0][i]), HalfToFloat(features[1][i]), 1e-3f)
          << i;
    }
    for (size_t i = 0; i < maps[0].size(); ++i) {
      ASSERT_NEAR(HalfToFloat(maps[0][i]), HalfToFloat(maps[1][i]), 4e-3f) << i;
    }
  }
}

}  // namespace
}  // namespace mfir
