// Patches fitted, aligned and searched on a GPU.

#pragma once

#include <algorithm>
#include <cstdint>
#include <memory>

#include "cuda/warp_group.h"
#include "src/patches/patch_backend.h"

namespace mfir {

// The GPU with CUDA's index `gpu_index`, -1: the one with the most
// multiprocessors. Throws GpuError, with the reason in one line: no CUDA in
// this build, no driver, no such GPU. So do the backend's functions when a CUDA
// call fails.
std::unique_ptr<PatchBackend> CreateGpuPatchBackend(int gpu_index);

// Geometry of the launches, for the tests on the CPU to run the same.
struct PatchLaunch {
  // A warp per patch (at a time): each thread has three of its samples.
  static constexpr int kWarpsPerBlock = 4;
  static constexpr int kBlockSize = kWarpsPerBlock * WarpGroup::Size();
  // A warp takes every n-th job, so that there is no limit on their number;
  // enough blocks for any GPU.
  static constexpr int kMaxNumBlocks = 8192;
  // Jobs in the GPU's memory at a time, with their results 13 MiB: enough to
  // fill any GPU.
  static constexpr int64_t kMaxNumJobs = int64_t{1} << 17;

  static int NumBlocks(int64_t num_jobs) {
    return static_cast<int>(std::min<int64_t>(
        kMaxNumBlocks, (num_jobs + kWarpsPerBlock - 1) / kWarpsPerBlock));
  }
};

}  // namespace mfir
