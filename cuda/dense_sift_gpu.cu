#include "cuda/dense_sift_gpu.h"

#include <algorithm>
#include <cstring>

#include "cuda/cost_maps_gpu.h"
#include "cuda/warp_group.h"
#include "src/parallel/parallel_for.h"

namespace mfir {
namespace {

constexpr int kWarpsPerBlock = GpuLaunch::kBlockSize / WarpGroup::Size();

__device__ int64_t ThreadInGrid() {
  return static_cast<int64_t>(blockIdx.x) * blockDim.x + threadIdx.x;
}

__device__ int64_t NumThreadsInGrid() {
  return static_cast<int64_t>(gridDim.x) * blockDim.x;
}

__device__ WarpGroup WarpOfThread() {
  return {static_cast<int>(threadIdx.x) % WarpGroup::Size()};
}

__device__ int WarpInBlock() {
  return static_cast<int>(threadIdx.x) / WarpGroup::Size();
}

__global__ void __launch_bounds__(GpuLaunch::kBlockSize)
    GradientsKernel(SiftLayout layout,
                    const float* grey,
                    SiftGradient* gradients) {
  ComputeSiftGradients(
      ThreadInGrid(), NumThreadsInGrid(), layout, grey, gradients);
}

__global__ void __launch_bounds__(GpuLaunch::kBlockSize)
    RowSumsKernel(SiftLayout layout,
                  const SiftGradient* gradients,
                  float* row_sums) {
  ComputeSiftRowSums(
      ThreadInGrid(), NumThreadsInGrid(), layout, gradients, row_sums);
}

__global__ void __launch_bounds__(GpuLaunch::kBlockSize)
    BinsKernel(SiftLayout layout, const float* row_sums, float* bins) {
  ComputeSiftBins(ThreadInGrid(), NumThreadsInGrid(), layout, row_sums, bins);
}

// A block per patch (at a time), a warp per descriptor.
__global__ void __launch_bounds__(GpuLaunch::kBlockSize)
    PatchesKernel(SiftLayout layout,
                  const float* bins,
                  const SiftCorner* corners,
                  int64_t num_patches,
                  PatchShape shape,
                  uint16_t* patches) {
  for (int64_t i = blockIdx.x; i < num_patches; i += gridDim.x) {
    ComputeSiftPatch(WarpOfThread(),
                     WarpInBlock(),
                     kWarpsPerBlock,
                     layout,
                     bins,
                     corners[i],
                     shape.patch_size,
                     patches + static_cast<size_t>(i) * shape.NumElements());
  }
}

// A warp per keypoint.
__global__ void __launch_bounds__(GpuLaunch::kBlockSize)
    InterpolateKernel(SiftLayout layout,
                      const float* bins,
                      const DenseSiftKeypoint* keypoints,
                      int64_t num_keypoints,
                      uint16_t* features) {
  const int64_t stride = static_cast<int64_t>(gridDim.x) * kWarpsPerBlock;
  for (int64_t i =
           static_cast<int64_t>(blockIdx.x) * kWarpsPerBlock + WarpInBlock();
       i < num_keypoints;
       i += stride) {
    InterpolateSiftFeature(WarpOfThread(),
                           layout,
                           bins,
                           keypoints[i],
                           features + i * kNumSiftChannels);
  }
}

int NumBlocks(int64_t num_items, int items_per_block) {
  return GpuLaunch::NumBlocks((num_items + items_per_block - 1) /
                              items_per_block);
}

}  // namespace

void GpuSift::CopyImage(const std::vector<float>& grey,
                        Buffer<float>* gpu_grey) {
  constexpr size_t kChunk = size_t{1} << 18;
  stream_.Wait();  // for the image before, which is in the same memory
  host_grey_.Reserve(grey.size());
  gpu_grey->Reserve(grey.size());
  ParallelFor((grey.size() + kChunk - 1) / kChunk, num_threads_, [&](size_t i) {
    const size_t begin = i * kChunk;
    std::memcpy(host_grey_.Data() + begin,
                grey.data() + begin,
                std::min(kChunk, grey.size() - begin) * sizeof(float));
  });
  Copy(gpu_grey->Data(),
       host_grey_.Data(),
       grey.size(),
       cudaMemcpyHostToDevice,
       stream_.Get());
}

void GpuSift::ComputeBins(const SiftLayout& layout, const float* gpu_grey) {
  const int64_t num_gradients = layout.Gradients().NumPixels();
  const int64_t num_row_sums =
      layout.RowSums().NumPixels() * kNumSiftOrientations;
  const int64_t num_bins = layout.Bins().NumPixels() * kNumSiftOrientations;
  gradients_.Reserve(static_cast<size_t>(num_gradients));
  row_sums_.Reserve(static_cast<size_t>(num_row_sums));
  bins_.Reserve(static_cast<size_t>(num_bins));
  layout_ = layout;
  constexpr int kBlockSize = GpuLaunch::kBlockSize;
  GradientsKernel<<<NumBlocks(num_gradients, kBlockSize),
                    kBlockSize,
                    0,
                    stream_.Get()>>>(layout, gpu_grey, gradients_.Data());
  RowSumsKernel<<<NumBlocks(num_row_sums, kBlockSize),
                  kBlockSize,
                  0,
                  stream_.Get()>>>(layout, gradients_.Data(), row_sums_.Data());
  BinsKernel<<<NumBlocks(num_bins, kBlockSize), kBlockSize, 0, stream_.Get()>>>(
      layout, row_sums_.Data(), bins_.Data());
  Check(cudaGetLastError(), "Launching the kernels of dense SIFT");
  bins_done_.Record(stream_.Get());
}

void GpuSift::Interpolate(const std::vector<DenseSiftKeypoint>& keypoints,
                          uint16_t* features) {
  if (keypoints.empty()) return;
  const int64_t count = static_cast<int64_t>(keypoints.size());
  const size_t num_values = keypoints.size() * kNumSiftChannels;
  keypoints_.Reserve(keypoints.size());
  features_.Reserve(num_values);
  Copy(keypoints_.Data(),
       keypoints.data(),
       keypoints.size(),
       cudaMemcpyHostToDevice,
       stream_.Get());
  InterpolateKernel<<<NumBlocks(count, kWarpsPerBlock),
                      GpuLaunch::kBlockSize,
                      0,
                      stream_.Get()>>>(
      layout_, bins_.Data(), keypoints_.Data(), count, features_.Data());
  Check(cudaGetLastError(), "Launching the kernel of dense SIFT features");
  Copy(features,
       features_.Data(),
       num_values,
       cudaMemcpyDeviceToHost,
       stream_.Get());
  stream_.Wait();
}

void GpuSift::ComputePatches(const SiftCorner* corners,
                             int64_t num_patches,
                             int patch_size,
                             uint16_t* patches,
                             cudaStream_t stream) const {
  bins_done_.Block(stream);
  PatchesKernel<<<GpuLaunch::NumBlocks(num_patches),
                  GpuLaunch::kBlockSize,
                  0,
                  stream>>>(layout_,
                            bins_.Data(),
                            corners,
                            num_patches,
                            PatchShape{patch_size, kNumSiftChannels},
                            patches);
  Check(cudaGetLastError(), "Launching the kernel of dense SIFT patches");
}

}  // namespace mfir
