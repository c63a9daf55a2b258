// Dense SIFT on the GPU that is current: launches of the functions in
// src/dense/dense_sift_kernels.h.

#pragma once

#include <cstdint>
#include <vector>

#include "cuda/cuda_calls.h"
#include "src/dense/dense_sift_kernels.h"

namespace mfir {

class GpuSift {
 public:
  explicit GpuSift(int num_threads) : num_threads_(num_threads) {}

  // The image is on its way on return.
  void CopyImage(const std::vector<float>& grey, Buffer<float>* gpu_grey);

  // Launches the computation of what all descriptors of the image are made of.
  // The patches of the image before must be done.
  void ComputeBins(const SiftLayout& layout, const float* gpu_grey);

  // The functions below are about the image of the last ComputeBins.

  // Done on return.
  void Interpolate(const std::vector<DenseSiftKeypoint>& keypoints,
                   uint16_t* features);

  // Launches in `stream`; corners and patches are in the GPU's memory.
  void ComputePatches(const SiftCorner* corners,
                      int64_t num_patches,
                      int patch_size,
                      uint16_t* patches,
                      cudaStream_t stream) const;

 private:
  const int num_threads_;
  SiftLayout layout_ = {};
  Buffer<float> host_grey_{Memory::kPinnedHost};
  Buffer<SiftGradient> gradients_{Memory::kDevice};
  Buffer<float> row_sums_{Memory::kDevice};
  Buffer<float> bins_{Memory::kDevice};
  Buffer<DenseSiftKeypoint> keypoints_{Memory::kDevice};
  Buffer<uint16_t> features_{Memory::kDevice};
  Event bins_done_;
  Stream stream_;  // last: waited for before the buffers go
};

}  // namespace mfir
