// The threads of a warp as a group (thread_group.h), on the GPU.

#pragma once

#include "src/parallel/thread_group.h"

// Functions of groups are only called on the GPU; they are declared for both
// since the functions that call them are.
#if defined(__CUDA_ARCH__)
#define MFIR_ON_GPU(...) __VA_ARGS__
#else
#define MFIR_ON_GPU(...)
#endif

namespace mfir {

struct WarpGroup {
  int rank;
  MFIR_HOST_DEVICE int Rank() const { return rank; }
  MFIR_HOST_DEVICE static constexpr int Size() { return 32; }
  MFIR_HOST_DEVICE void Sync() const { MFIR_ON_GPU(__syncwarp();) }
  MFIR_HOST_DEVICE float Sum(float value) const {
    // Adds in pairs, so that all threads get the same bits.
    MFIR_ON_GPU(for (int lane = Size() / 2; lane > 0; lane /= 2) {
      value += __shfl_xor_sync(0xffffffffu, value, lane);
    })
    return value;
  }
};

}  // namespace mfir
