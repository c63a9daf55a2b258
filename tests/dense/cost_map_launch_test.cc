// What the CUDA launchers do, executed on the CPU: the same functions, the same
// grids of blocks and threads, the threads of a block as threads of the CPU.

#include <memory>
#include <vector>

#include <gtest/gtest.h>

#include "cuda/cost_maps_gpu.h"
#include "src/util/gpu_choice.h"
#include "tests/support/test_features.h"
#include "tests/support/thread_block.h"

namespace mfir {
namespace {

TEST(CostMapLaunch, BlocksOfThreadsComputeCostMaps) {
  constexpr int64_t kNumPatches = 5;
  constexpr int kNumBlocks = 2;
  for (const PatchShape& shape :
       {PatchShape{16, 128}, PatchShape{5, 37}, PatchShape{24, 17}}) {
    const size_t count = kNumPatches;
    const std::vector<uint16_t> patches =
        RandomHalves(count * shape.NumElements(), 1);
    const std::vector<uint16_t> references =
        RandomHalves(count * shape.num_channels, 2);
    std::vector<uint16_t> expected(count * shape.NumCostElements());
    std::vector<CostMapJob> jobs;
    for (size_t i = 0; i < count; ++i) {
      jobs.push_back({patches.data() + i * shape.NumElements(),
                      references.data() + i * shape.num_channels,
                      expected.data() + i * shape.NumCostElements()});
    }
    CreateCpuCostMapBackend(1)->ComputeMaps(shape, 0.5f, jobs);

    std::vector<uint16_t> cost_maps(expected.size(), 0xffff);
    for (int block = 0; block < kNumBlocks; ++block) {
      std::vector<float> shared(GpuLaunch::SharedBytes(shape) / sizeof(float));
      auto* products = reinterpret_cast<PixelProducts*>(
          shared.data() +
          DifferencesSize(shape, GpuLaunch::kChunk, GpuLaunch::kPitch));
      RunBlock<GpuLaunch::kNumRows, GpuLaunch::kNumColumns>(
          [&](const auto& group) {
            ComputeCostMaps(group,
                            block,
                            kNumBlocks,
                            shape,
                            0.5f,
                            patches.data(),
                            references.data(),
                            kNumPatches,
                            GpuLaunch::kChunk,
                            GpuLaunch::kPitch,
                            shared.data(),
                            products,
                            cost_maps.data());
          });
    }
    for (size_t i = 0; i < expected.size(); ++i) {
      ASSERT_NEAR(HalfToFloat(cost_maps[i]), HalfToFloat(expected[i]), 0.016)
          << i;
    }
  }
}

TEST(CostMapLaunch, WarpsFindReferences) {
  constexpr int kNumChannels = 70;
  constexpr int kNumBlocks = 3;
  const std::vector<int64_t> track_begins = {0, 4, 4, 5, 12, 30, 42};
  constexpr int64_t kNumTracks = 6;
  std::vector<uint16_t> features = RandomHalves(42 * kNumChannels, 3);
  features[7 * kNumChannels + 3] = 0x7e00;
  std::vector<int64_t> references(kNumTracks, -2);
  std::vector<float> scratch(
      GpuLaunch::ScratchOffset(kNumBlocks, kNumChannels));
  for (int block = 0; block < kNumBlocks; ++block) {
    RunBlock<1, GpuLaunch::kWarpSize>([&](const auto& group) {
      FindReferenceFeatures(
          group,
          block,
          kNumBlocks,
          features.data(),
          track_begins.data(),
          kNumTracks,
          kNumChannels,
          0.25f,
          scratch.data() + GpuLaunch::ScratchOffset(block, kNumChannels),
          references.data());
    });
  }
  EXPECT_EQ(references,
            CreateCpuCostMapBackend(1)->FindReferences(
                features, track_begins, kNumChannels, 0.25f));
}

TEST(CostMapLaunch, GridCoversAnyNumberOfPatches) {
  const PatchShape shape = {4, 1};
  constexpr size_t kNumPatches = 150000;
  const std::vector<uint16_t> patches =
      RandomHalves(kNumPatches * shape.NumElements(), 4);
  const std::vector<uint16_t> references = RandomHalves(kNumPatches, 5);
  std::vector<uint16_t> cost_maps(kNumPatches * shape.NumCostElements(),
                                  0xffff);
  std::vector<float> differences(
      DifferencesSize(shape, GpuLaunch::kChunk, GpuLaunch::kPitch));
  std::vector<PixelProducts> products(shape.NumPixels());
  const int num_blocks = GpuLaunch::NumBlocks(kNumPatches);
  EXPECT_EQ(num_blocks, GpuLaunch::kMaxNumBlocks);
  for (int block = 0; block < num_blocks; ++block) {
    ComputeCostMaps(SerialGroup(),
                    block,
                    num_blocks,
                    shape,
                    1.0f,
                    patches.data(),
                    references.data(),
                    kNumPatches,
                    GpuLaunch::kChunk,
                    GpuLaunch::kPitch,
                    differences.data(),
                    products.data(),
                    cost_maps.data());
  }
  for (const size_t i :
       {size_t{0}, size_t{65536}, size_t{131072}, kNumPatches - 1}) {
    const std::vector<double> expected =
        PlainCostMap(shape,
                     1.0,
                     patches.data() + i * shape.NumElements(),
                     references.data() + i);
    for (size_t k = 0; k < expected.size(); ++k) {
      EXPECT_NEAR(HalfToFloat(cost_maps[i * shape.NumCostElements() + k]),
                  expected[k],
                  1e-2);
    }
  }
  for (const uint16_t value : cost_maps) ASSERT_NE(value, 0xffff);
}

TEST(CostMapLaunch, OffsetsBeyond32Bits) {
  const PatchShape shape = {16, 128};
  EXPECT_EQ(shape.NumElements(), 32768u);
  const size_t offset = size_t{200000} * shape.NumElements();
  EXPECT_EQ(offset, 6553600000u);
  EXPECT_EQ(GpuLaunch::ScratchOffset(size_t{1} << 30, 128), size_t{1} << 38);
}

TEST(CostMapLaunch, BatchesFitIntoFreeMemory) {
  const PatchShape shape = {16, 128};
  const size_t bytes = GpuLaunch::BytesPerPatch(shape);
  EXPECT_EQ(bytes, 65536u + 256u + 1536u);
  EXPECT_EQ(GpuLaunch::BatchSize(shape, 0, 2), 0);
  EXPECT_EQ(GpuLaunch::BatchSize(shape, 4 * bytes - 1, 2), 0);
  EXPECT_EQ(GpuLaunch::BatchSize(shape, 4 * bytes, 2), 1);
  EXPECT_EQ(GpuLaunch::BatchSize(shape, 400 * bytes, 2), 100);
  EXPECT_EQ(GpuLaunch::BatchSize(shape, size_t{80} << 30, 2),
            (64 << 20) / static_cast<int64_t>(bytes));
  EXPECT_EQ(GpuLaunch::NumBlocks(1), 1);
  EXPECT_EQ(GpuLaunch::NumBlocks(int64_t{1} << 40), GpuLaunch::kMaxNumBlocks);
  // Of a block on any GPU of compute capability 7.5 and above.
  EXPECT_LE(GpuLaunch::SharedBytes({kMaxPatchSize, 128}), 64u << 10);
}

// The twin of the GPU, where there is one.
TEST(CostMapGpu, EqualsTheCpu) {
  std::unique_ptr<CostMapBackend> gpu;
  try {
    gpu = CreateGpuCostMapBackend(-1, -1);
  } catch (const GpuError& error) {
    GTEST_SKIP() << "no GPU: " << error.what();
  }
  const auto cpu = CreateCpuCostMapBackend(-1);
  for (const PatchShape& shape :
       {PatchShape{16, 128}, PatchShape{24, 70}, PatchShape{4, 1}}) {
    const size_t count = shape.num_channels == 1 ? 150000 : 3000;
    const std::vector<uint16_t> patches =
        RandomHalves(count * shape.NumElements(), 6);
    const std::vector<uint16_t> references =
        RandomHalves(count * shape.num_channels, 7);
    std::vector<uint16_t> results[2];
    for (int k = 0; k < 2; ++k) {
      results[k].resize(count * shape.NumCostElements());
      std::vector<CostMapJob> jobs;
      for (size_t i = 0; i < count; ++i) {
        jobs.push_back({patches.data() + i * shape.NumElements(),
                        references.data() + i * shape.num_channels,
                        results[k].data() + i * shape.NumCostElements()});
      }
      (k == 0 ? gpu : cpu)->ComputeMaps(shape, 1.0f, jobs);
    }
    for (size_t i = 0; i < results[0].size(); ++i) {
      const float value = HalfToFloat(results[1][i]);
      ASSERT_NEAR(
          HalfToFloat(results[0][i]), value, 1e-3f * std::abs(value) + 1e-3f)
          << i;
    }
  }
  const std::vector<uint16_t> features = RandomHalves(30000 * 32, 8);
  std::vector<int64_t> track_begins = {0};
  while (track_begins.back() < 30000) {
    track_begins.push_back(std::min<int64_t>(
        30000, track_begins.back() + 1 + (track_begins.size() % 50)));
  }
  const auto gpu_references =
      gpu->FindReferences(features, track_begins, 32, 0.25f);
  const auto cpu_references =
      cpu->FindReferences(features, track_begins, 32, 0.25f);
  size_t num_different = 0;
  for (size_t i = 0; i < cpu_references.size(); ++i) {
    num_different += gpu_references[i] != cpu_references[i];
  }
  // Ties within rounding.
  EXPECT_LE(num_different, cpu_references.size() / 100);
}

TEST(CostMapGpu, UnknownGpuIsAnError) {
  try {
    CreateGpuCostMapBackend(1000, 1);
    FAIL() << "there is no such GPU";
  } catch (const GpuError& error) {
    EXPECT_STRNE(error.what(), "");
    EXPECT_EQ(std::string(error.what()).find('\n'), std::string::npos);
  }
}

}  // namespace
}  // namespace mfir
