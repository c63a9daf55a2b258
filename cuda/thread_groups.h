// Groups of threads (src/util/thread_group.h) of CUDA kernels.

#pragma once

#include "cuda/cost_maps_gpu.h"

namespace mfir {

// Functions of groups are only called on the GPU; they are declared for both
// since the functions that call them are.
#if defined(__CUDA_ARCH__)
#define MFIR_ON_GPU(...) __VA_ARGS__
#else
#define MFIR_ON_GPU(...)
#endif

// A block with one dimension.
struct BlockGroup {
  int rank;
  MFIR_HOST_DEVICE int Rank() const { return rank; }
  MFIR_HOST_DEVICE static constexpr int Size() { return GpuLaunch::kBlockSize; }
  MFIR_HOST_DEVICE int Row() const { return rank / GpuLaunch::kNumColumns; }
  MFIR_HOST_DEVICE static constexpr int NumRows() {
    return GpuLaunch::kNumRows;
  }
  MFIR_HOST_DEVICE int Column() const { return rank % GpuLaunch::kNumColumns; }
  MFIR_HOST_DEVICE static constexpr int NumColumns() {
    return GpuLaunch::kNumColumns;
  }
  MFIR_HOST_DEVICE void Sync() const { MFIR_ON_GPU(__syncthreads();) }
};

// One warp.
struct WarpGroup {
  int rank;
  MFIR_HOST_DEVICE int Rank() const { return rank; }
  MFIR_HOST_DEVICE static constexpr int Size() { return GpuLaunch::kWarpSize; }
  MFIR_HOST_DEVICE float Sum(float value) const {
    // Adds in pairs, so that all threads get the same bits.
    MFIR_ON_GPU(for (int lane = Size() / 2; lane > 0; lane /= 2) {
      value += __shfl_xor_sync(0xffffffffu, value, lane);
    })
    return value;
  }
};

}  // namespace mfir
