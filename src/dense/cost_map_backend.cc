#include "src/dense/cost_map_backend.h"

#include <algorithm>

#include "src/parallel/parallel_for.h"
#include "src/util/target_clones.h"

namespace mfir {
namespace {

// All channels of the usual features at once: long loops.
constexpr int kChannelsPerChunk = 128;
constexpr size_t kItemsPerTask = 64;

struct Scratch {
  std::vector<float> floats;
  std::vector<PixelProducts> products;
};

MFIR_TARGET_CLONES
void FindReferencesOnCpu(const uint16_t* features,
                         const int64_t* track_begins,
                         int64_t num_tracks,
                         int num_channels,
                         float loss_scale,
                         float* scratch,
                         int64_t* references) {
  FindReferenceFeatures(SerialGroup(),
                        0,
                        1,
                        features,
                        track_begins,
                        num_tracks,
                        num_channels,
                        loss_scale,
                        scratch,
                        references);
}

MFIR_TARGET_CLONES
void ComputeMapOnCpu(const PatchShape& shape,
                     float inverse_pixel_size,
                     const CostMapJob& job,
                     float* differences,
                     PixelProducts* products) {
  ComputeCostMap(SerialGroup(),
                 shape,
                 inverse_pixel_size,
                 job.patch,
                 job.reference,
                 kChannelsPerChunk,
                 kChannelsPerChunk,
                 differences,
                 products,
                 job.cost_map);
}

// Calls function(begin, end) for consecutive parts of [0, count).
template <typename Function>
void ParallelForRanges(size_t count,
                       int num_threads,
                       const Function& function) {
  const size_t num_tasks = (count + kItemsPerTask - 1) / kItemsPerTask;
  ParallelFor(num_tasks, num_threads, [&](size_t task) {
    const size_t begin = task * kItemsPerTask;
    function(begin, std::min(count, begin + kItemsPerTask));
  });
}

class CpuCostMapBackend final : public CostMapBackend {
 public:
  explicit CpuCostMapBackend(int num_threads) : num_threads_(num_threads) {}

  std::string Name() const override { return "CPU"; }

  std::vector<int64_t> FindReferences(const std::vector<uint16_t>& features,
                                      const std::vector<int64_t>& track_begins,
                                      int num_channels,
                                      float loss_scale) override {
    std::vector<int64_t> references(track_begins.size() - 1);
    ParallelForRanges(
        references.size(), num_threads_, [&](size_t begin, size_t end) {
          thread_local std::vector<float> scratch;
          scratch.resize(2 * static_cast<size_t>(num_channels));
          FindReferencesOnCpu(features.data(),
                              track_begins.data() + begin,
                              static_cast<int64_t>(end - begin),
                              num_channels,
                              loss_scale,
                              scratch.data(),
                              references.data() + begin);
        });
    return references;
  }

  void ComputeMaps(const PatchShape& shape,
                   float inverse_pixel_size,
                   const std::vector<CostMapJob>& jobs) override {
    ParallelForRanges(jobs.size(), num_threads_, [&](size_t begin, size_t end) {
      thread_local Scratch scratch;
      scratch.floats.resize(static_cast<size_t>(
          DifferencesSize(shape, kChannelsPerChunk, kChannelsPerChunk)));
      scratch.products.resize(static_cast<size_t>(shape.NumPixels()));
      for (size_t i = begin; i < end; ++i) {
        ComputeMapOnCpu(shape,
                        inverse_pixel_size,
                        jobs[i],
                        scratch.floats.data(),
                        scratch.products.data());
      }
    });
  }

 private:
  const int num_threads_;
};

}  // namespace

std::unique_ptr<CostMapBackend> CreateCpuCostMapBackend(int num_threads) {
  return std::make_unique<CpuCostMapBackend>(num_threads);
}

}  // namespace mfir
