#include "cuda/cost_maps_gpu.h"

#include <cstring>
#include <deque>
#include <string>
#include <vector>

#include <cuda_runtime.h>

#include "cuda/cuda_calls.h"
#include "cuda/warp_group.h"
#include "src/util/parallel_for.h"

namespace mfir {
namespace {

// -----------------------------------------------------------------------------
// Kernels: groups of threads for the functions of cost_map_kernels.h
// -----------------------------------------------------------------------------

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

__global__ void __launch_bounds__(GpuLaunch::kWarpSize)
    FindReferencesKernel(const uint16_t* features,
                         const int64_t* track_begins,
                         int64_t num_tracks,
                         int num_channels,
                         float loss_scale,
                         float* scratch,
                         int64_t* references) {
  FindReferenceFeatures(
      WarpGroup{static_cast<int>(threadIdx.x)},
      blockIdx.x,
      gridDim.x,
      features,
      track_begins,
      num_tracks,
      num_channels,
      loss_scale,
      scratch + GpuLaunch::ScratchOffset(blockIdx.x, num_channels),
      references);
}

__global__ void __launch_bounds__(GpuLaunch::kBlockSize)
    ComputeMapsKernel(PatchShape shape,
                      float inverse_pixel_size,
                      const uint16_t* patches,
                      const uint16_t* references,
                      int64_t num_patches,
                      uint16_t* cost_maps) {
  extern __shared__ float shared[];
  ComputeCostMaps(
      BlockGroup{static_cast<int>(threadIdx.x)},
      blockIdx.x,
      gridDim.x,
      shape,
      inverse_pixel_size,
      patches,
      references,
      num_patches,
      GpuLaunch::kChunk,
      GpuLaunch::kPitch,
      shared,
      reinterpret_cast<PixelProducts*>(
          shared +
          DifferencesSize(shape, GpuLaunch::kChunk, GpuLaunch::kPitch)),
      cost_maps);
}

// -----------------------------------------------------------------------------
// Launches
// -----------------------------------------------------------------------------

// A batch of patches on its way: staged in pinned memory, copied, computed and
// copied back in a stream of its own, while the other is being staged.
class BatchSlot {
 public:
  void Start(const PatchShape& shape,
             float inverse_pixel_size,
             const CostMapJob* jobs,
             int64_t num_jobs,
             int num_threads) {
    Finish(shape);
    const size_t count = static_cast<size_t>(num_jobs);
    const size_t num_channels = static_cast<size_t>(shape.num_channels);
    const size_t inputs_size = count * (shape.NumElements() + num_channels);
    const size_t outputs_size = count * shape.NumCostElements();
    host_inputs_.Reserve(inputs_size);
    host_outputs_.Reserve(outputs_size);
    inputs_.Reserve(inputs_size);
    outputs_.Reserve(outputs_size);
    uint16_t* host_references =
        host_inputs_.Data() + count * shape.NumElements();
    ParallelFor(count, num_threads, [&](size_t i) {
      std::memcpy(host_inputs_.Data() + i * shape.NumElements(),
                  jobs[i].patch,
                  shape.NumElements() * sizeof(uint16_t));
      std::memcpy(host_references + i * num_channels,
                  jobs[i].reference,
                  num_channels * sizeof(uint16_t));
    });
    jobs_ = jobs;
    num_jobs_ = num_jobs;
    Copy(inputs_.Data(),
         host_inputs_.Data(),
         inputs_size,
         cudaMemcpyHostToDevice,
         stream_.Get());
    ComputeMapsKernel<<<GpuLaunch::NumBlocks(num_jobs),
                        GpuLaunch::kBlockSize,
                        GpuLaunch::SharedBytes(shape),
                        stream_.Get()>>>(
        shape,
        inverse_pixel_size,
        inputs_.Data(),
        inputs_.Data() + count * shape.NumElements(),
        num_jobs,
        outputs_.Data());
    Check(cudaGetLastError(), "Launching the kernel of cost maps");
    Copy(host_outputs_.Data(),
         outputs_.Data(),
         outputs_size,
         cudaMemcpyDeviceToHost,
         stream_.Get());
  }

  // Waits for the batch, if there is one, and hands out its cost maps.
  void Finish(const PatchShape& shape) {
    if (num_jobs_ == 0) return;
    stream_.Wait();
    const size_t size = shape.NumCostElements();
    for (int64_t i = 0; i < num_jobs_; ++i) {
      std::memcpy(jobs_[i].cost_map,
                  host_outputs_.Data() + i * size,
                  size * sizeof(uint16_t));
    }
    num_jobs_ = 0;
  }

 private:
  Buffer<uint16_t> host_inputs_{Memory::kPinnedHost};
  Buffer<uint16_t> host_outputs_{Memory::kPinnedHost};
  Buffer<uint16_t> inputs_{Memory::kDevice};
  Buffer<uint16_t> outputs_{Memory::kDevice};
  const CostMapJob* jobs_ = nullptr;
  int64_t num_jobs_ = 0;
  Stream stream_;  // last: waited for before the buffers go
};

class GpuCostMapBackend final : public CostMapBackend {
 public:
  GpuCostMapBackend(int gpu_index, int num_threads)
      : gpu_index_(ChooseGpu(gpu_index, &name_)), num_threads_(num_threads) {
    // A GPU whose driver or architecture does not fit fails here at the latest.
    UseGpu();
    cudaFuncAttributes attributes;
    Check(cudaFuncGetAttributes(&attributes, ComputeMapsKernel),
          "Loading the kernels");
  }

  std::string Name() const override { return name_; }

  std::vector<int64_t> FindReferences(const std::vector<uint16_t>& features,
                                      const std::vector<int64_t>& track_begins,
                                      int num_channels,
                                      float loss_scale) override {
    UseGpu();
    const int64_t num_tracks = static_cast<int64_t>(track_begins.size()) - 1;
    std::vector<int64_t> references(static_cast<size_t>(num_tracks));
    if (num_tracks == 0 || features.empty()) {
      std::fill(references.begin(), references.end(), int64_t{-1});
      return references;
    }
    const int num_blocks = GpuLaunch::NumBlocks(num_tracks);
    Buffer<uint16_t> gpu_features(Memory::kDevice);
    Buffer<int64_t> gpu_track_begins(Memory::kDevice);
    Buffer<int64_t> gpu_references(Memory::kDevice);
    Buffer<float> scratch(Memory::kDevice);
    gpu_features.Reserve(features.size());
    gpu_track_begins.Reserve(track_begins.size());
    gpu_references.Reserve(references.size());
    scratch.Reserve(GpuLaunch::ScratchOffset(num_blocks, num_channels));
    const Stream stream;
    Copy(gpu_features.Data(),
         features.data(),
         features.size(),
         cudaMemcpyHostToDevice,
         stream.Get());
    Copy(gpu_track_begins.Data(),
         track_begins.data(),
         track_begins.size(),
         cudaMemcpyHostToDevice,
         stream.Get());
    FindReferencesKernel<<<num_blocks, GpuLaunch::kWarpSize, 0, stream.Get()>>>(
        gpu_features.Data(),
        gpu_track_begins.Data(),
        num_tracks,
        num_channels,
        loss_scale,
        scratch.Data(),
        gpu_references.Data());
    Check(cudaGetLastError(), "Launching the kernel of reference features");
    Copy(references.data(),
         gpu_references.Data(),
         references.size(),
         cudaMemcpyDeviceToHost,
         stream.Get());
    stream.Wait();
    return references;
  }

  void ComputeMaps(const PatchShape& shape,
                   float inverse_pixel_size,
                   const std::vector<CostMapJob>& jobs) override {
    UseGpu();
    Prepare(shape);
    const int64_t num_jobs = static_cast<int64_t>(jobs.size());
    for (int64_t begin = 0; begin < num_jobs; begin += batch_size_) {
      slots_[begin / batch_size_ % GpuLaunch::kNumStreams].Start(
          shape,
          inverse_pixel_size,
          jobs.data() + begin,
          std::min(batch_size_, num_jobs - begin),
          num_threads_);
    }
    for (BatchSlot& slot : slots_) slot.Finish(shape);
  }

 private:
  // The current GPU is a property of the calling thread.
  void UseGpu() const { Check(cudaSetDevice(gpu_index_), "Selecting the GPU"); }

  // Makes room for batches of this shape, unless that is done.
  void Prepare(const PatchShape& shape) {
    if (batch_size_ > 0 && shape.patch_size == shape_.patch_size &&
        shape.num_channels == shape_.num_channels) {
      return;
    }
    slots_.clear();
    // More than 48 KiB (patches above 23x23) has to be asked for.
    Check(cudaFuncSetAttribute(ComputeMapsKernel,
                               cudaFuncAttributeMaxDynamicSharedMemorySize,
                               static_cast<int>(GpuLaunch::SharedBytes(shape))),
          "Setting the size of the shared memory");
    size_t free_bytes = 0;
    size_t total_bytes = 0;
    Check(cudaMemGetInfo(&free_bytes, &total_bytes), "Querying GPU memory");
    batch_size_ =
        GpuLaunch::BatchSize(shape, free_bytes, GpuLaunch::kNumStreams);
    if (batch_size_ == 0) throw GpuError("no GPU memory is free");
    shape_ = shape;
    for (int i = 0; i < GpuLaunch::kNumStreams; ++i) slots_.emplace_back();
  }

  std::string name_;
  const int gpu_index_;
  const int num_threads_;
  PatchShape shape_ = {0, 0};
  int64_t batch_size_ = 0;
  std::deque<BatchSlot> slots_;
};

}  // namespace

std::unique_ptr<CostMapBackend> CreateGpuCostMapBackend(int gpu_index,
                                                        int num_threads) {
  return std::make_unique<GpuCostMapBackend>(gpu_index, num_threads);
}

}  // namespace mfir
