// Throughput of reference features and cost maps on one core of the CPU, with
// features in memory: items_per_second are tracks and patches. Where there is a
// GPU, also of all that it does for the patches of dense SIFT.

#include <cstdint>
#include <vector>

#include <benchmark/benchmark.h>

#include "cuda/cost_maps_gpu.h"
#include "src/dense/cost_map_backend.h"
#include "src/util/gpu_choice.h"
#include "src/util/random.h"

namespace mfir {
namespace {

// Rows of unit length.
std::vector<uint16_t> RandomFeatures(size_t num_rows, int num_channels) {
  Random random({1});
  std::vector<uint16_t> features;
  std::vector<float> row(static_cast<size_t>(num_channels));
  for (size_t i = 0; i < num_rows; ++i) {
    float squared = 0.0f;
    for (float& value : row) {
      value = static_cast<float>(random.Normal());
      squared += value * value;
    }
    for (const float value : row) {
      features.push_back(FloatToHalf(value / std::sqrt(squared)));
    }
  }
  return features;
}

// More patches than the last-level cache holds.
void BM_CostMaps(benchmark::State& state) {
  constexpr size_t kNumPatches = 4096;
  const PatchShape shape = {static_cast<int>(state.range(0)),
                            static_cast<int>(state.range(1))};
  const std::vector<uint16_t> pixels =
      RandomFeatures(shape.NumPixels(), shape.num_channels);
  std::vector<uint16_t> patches;
  for (size_t i = 0; i < kNumPatches; ++i) {
    patches.insert(patches.end(), pixels.begin(), pixels.end());
  }
  std::vector<uint16_t> cost_maps(kNumPatches * shape.NumCostElements());
  std::vector<CostMapJob> jobs;
  for (size_t i = 0; i < kNumPatches; ++i) {
    jobs.push_back({patches.data() + i * shape.NumElements(),
                    pixels.data(),
                    cost_maps.data() + i * shape.NumCostElements()});
  }
  const auto backend = CreateCpuCostMapBackend(1);
  for (auto _ : state) {
    backend->ComputeMaps(shape, 1.0f, jobs);
    benchmark::ClobberMemory();
  }
  const auto num_patches =
      static_cast<int64_t>(kNumPatches) * state.iterations();
  state.SetItemsProcessed(num_patches);
  state.SetBytesProcessed(
      num_patches *
      static_cast<int64_t>(sizeof(uint16_t) *
                           (shape.NumElements() + shape.NumCostElements())));
}
BENCHMARK(BM_CostMaps)
    ->ArgNames({"patch", "channels"})
    ->Args({16, 128})
    ->Args({16, 64})
    ->Args({10, 128})
    ->Unit(benchmark::kMillisecond);

void BM_References(benchmark::State& state) {
  constexpr int kNumChannels = 128;
  constexpr size_t kNumTracks = 2000;
  const size_t length = static_cast<size_t>(state.range(0));
  const std::vector<uint16_t> features =
      RandomFeatures(kNumTracks * length, kNumChannels);
  std::vector<int64_t> track_begins;
  for (size_t i = 0; i <= kNumTracks; ++i) {
    track_begins.push_back(static_cast<int64_t>(i * length));
  }
  const auto backend = CreateCpuCostMapBackend(1);
  for (auto _ : state) {
    benchmark::DoNotOptimize(
        backend->FindReferences(features, track_begins, kNumChannels, 0.25f));
  }
  state.SetItemsProcessed(static_cast<int64_t>(kNumTracks) *
                          state.iterations());
}
BENCHMARK(BM_References)
    ->ArgNames({"length"})
    ->Args({5})
    ->Args({38})
    ->Unit(benchmark::kMillisecond);

// From an image in the host's memory to features and cost maps there.
void BM_SiftOnGpu(benchmark::State& state) {
  constexpr int kPatchSize = 16;
  std::unique_ptr<CostMapBackend> gpu;
  try {
    gpu = CreateGpuCostMapBackend(-1, -1);
  } catch (const GpuError& error) {
    state.SkipWithError(error.what());
    return;
  }
  const size_t num_patches = static_cast<size_t>(state.range(0));
  Random random({2});
  SiftImage image{1280, 1024, 4, {}};
  for (int i = 0; i < image.width * image.height; ++i) {
    image.grey.push_back(static_cast<float>(random.Uniform(0.0, 255.0)));
  }
  const std::vector<uint16_t> reference = RandomFeatures(1, 128);
  const size_t map_size = PatchShape{kPatchSize, 128}.NumCostElements();
  std::vector<uint16_t> features(num_patches * 128);
  std::vector<uint16_t> cost_maps(num_patches * map_size);
  std::vector<DenseSiftKeypoint> keypoints;
  std::vector<SiftMapJob> jobs;
  for (size_t i = 0; i < num_patches; ++i) {
    const SiftCorner corner = {
        static_cast<int>(random.Uniform(0.0, image.width - kPatchSize)),
        static_cast<int>(random.Uniform(0.0, image.height - kPatchSize))};
    jobs.push_back({corner, reference.data(), &cost_maps[i * map_size]});
    keypoints.push_back({{corner.x + 6, corner.y + 6},
                         {-0.0625f, 0.5625f, 0.5625f, -0.0625f},
                         {-0.0625f, 0.5625f, 0.5625f, -0.0625f}});
  }
  for (auto _ : state) {
    const auto sift = gpu->LoadSift(image);
    sift->Interpolate(keypoints, features.data());
    sift->ComputeMaps(kPatchSize, jobs);
    benchmark::ClobberMemory();
  }
  state.SetItemsProcessed(state.range(0) * state.iterations());
}
BENCHMARK(BM_SiftOnGpu)
    ->ArgNames({"patches"})
    ->Args({500})
    ->Args({2000})
    ->Args({8000})
    ->UseRealTime()
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace mfir
