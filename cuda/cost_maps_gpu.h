// Reference features and cost maps on a GPU.

#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <memory>

#include "cuda/warp_group.h"
#include "src/dense/cost_map_backend.h"

namespace mfir {

// The GPU with CUDA's index `gpu_index`, -1: the one with the most
// multiprocessors. Throws GpuError, with the reason in one line: no CUDA in
// this build, no driver, no such GPU. So do the backend's functions when a CUDA
// call fails.
std::unique_ptr<CostMapBackend> CreateGpuCostMapBackend(int gpu_index,
                                                        int num_threads);

// Geometry of the launches, for the tests on the CPU to run the same.
struct GpuLaunch {
  // Cost maps: a block per patch (at a time).
  static constexpr int kNumRows = 16;
  static constexpr int kNumColumns = 16;
  static constexpr int kBlockSize = kNumRows * kNumColumns;
  static constexpr int kChunk = 16;
  // Odd: the threads of a warp, each with a pixel of its own, read from
  // different banks of the shared memory.
  static constexpr int kPitch = kChunk + 1;
  // Reference features: a warp per track.
  static constexpr int kWarpSize = WarpGroup::Size();
  // A block takes every kMaxNumBlocks-th patch or track, so that there is no
  // limit on their number; enough blocks for any GPU.
  static constexpr int kMaxNumBlocks = 8192;
  // One batch of patches is copied while the other is computed.
  static constexpr int kNumStreams = 2;

  static int NumBlocks(int64_t num_items) {
    return static_cast<int>(std::min<int64_t>(kMaxNumBlocks, num_items));
  }

  // Of a block's part of the scratch memory, in floats.
  MFIR_HOST_DEVICE static size_t ScratchOffset(size_t block, int num_channels) {
    return block * 2 * static_cast<size_t>(num_channels);
  }

  static size_t SharedBytes(const PatchShape& shape) {
    return DifferencesSize(shape, kChunk, kPitch) * sizeof(float) +
           static_cast<size_t>(shape.NumPixels()) * sizeof(PixelProducts);
  }

  static size_t BytesPerPatch(const PatchShape& shape) {
    return sizeof(uint16_t) *
           (shape.NumElements() + static_cast<size_t>(shape.num_channels) +
            shape.NumCostElements());
  }

  // Patches per batch, of which `num_streams` are in memory at a time: half of
  // the free memory, but no more than 64 MiB each, which is long enough to
  // reach the full speed; 0 if there is no room for one patch.
  static int64_t BatchSize(const PatchShape& shape,
                           size_t free_bytes,
                           int num_streams) {
    constexpr size_t kMaxBatchBytes = size_t{64} << 20;
    const size_t share = free_bytes / 2 / static_cast<size_t>(num_streams);
    const size_t bytes = BytesPerPatch(shape);
    const size_t count = std::min(share, kMaxBatchBytes) / bytes;
    return static_cast<int64_t>(share >= bytes ? std::max<size_t>(count, 1)
                                               : 0);
  }
};

}  // namespace mfir
