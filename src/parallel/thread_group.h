// Threads that work on one item together, in code that runs on the CPU and in
// CUDA kernels. A group has
//   Rank(), Size()                            index of the thread, their number
//   Row(), NumRows(), Column(), NumColumns()  the same threads as a rectangle
//   Sync()                                    barrier
//   Sum(float)                                the same sum for all threads

#pragma once

#include "src/util/half_float.h"

namespace mfir {

// On the CPU: a single thread.
struct SerialGroup {
  MFIR_HOST_DEVICE static constexpr int Rank() { return 0; }
  MFIR_HOST_DEVICE static constexpr int Size() { return 1; }
  MFIR_HOST_DEVICE static constexpr int Row() { return 0; }
  MFIR_HOST_DEVICE static constexpr int NumRows() { return 1; }
  MFIR_HOST_DEVICE static constexpr int Column() { return 0; }
  MFIR_HOST_DEVICE static constexpr int NumColumns() { return 1; }
  MFIR_HOST_DEVICE static void Sync() {}
  MFIR_HOST_DEVICE static float Sum(float value) { return value; }
};

}  // namespace mfir
