#include "cuda/cost_maps_gpu.h"

#include <cstring>
#include <deque>
#include <optional>
#include <string>
#include <vector>

#include <cuda_runtime.h>

#include "cuda/cuda_calls.h"
#include "cuda/dense_sift_gpu.h"
#include "cuda/warp_group.h"
#include "src/parallel/parallel_for.h"

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
  // Patches from the host.
  void Start(const PatchShape& shape,
             float inverse_pixel_size,
             const CostMapJob* jobs,
             int64_t num_jobs,
             int num_threads) {
    const size_t size = shape.NumElements();
    Begin(shape, num_jobs, static_cast<size_t>(num_jobs) * size, num_threads);
    ParallelFor(outputs_of_jobs_.size(), num_threads, [&](size_t i) {
      std::memcpy(host_patches_.Data() + i * size,
                  jobs[i].patch,
                  size * sizeof(uint16_t));
      StageJob(shape, i, jobs[i].reference, jobs[i].cost_map);
    });
    Copy(patches_.Data(),
         host_patches_.Data(),
         outputs_of_jobs_.size() * size,
         cudaMemcpyHostToDevice,
         stream_.Get());
    ComputeMaps(shape, inverse_pixel_size);
  }

  // Patches that are computed by `sift`.
  void Start(const PatchShape& shape,
             const GpuSift& sift,
             const SiftMapJob* jobs,
             int64_t num_jobs,
             int num_threads) {
    Begin(shape, num_jobs, 0, num_threads);
    host_corners_.Reserve(outputs_of_jobs_.size());
    corners_.Reserve(outputs_of_jobs_.size());
    for (size_t i = 0; i < outputs_of_jobs_.size(); ++i) {
      host_corners_.Data()[i] = jobs[i].corner;
      StageJob(shape, i, jobs[i].reference, jobs[i].cost_map);
    }
    Copy(corners_.Data(),
         host_corners_.Data(),
         outputs_of_jobs_.size(),
         cudaMemcpyHostToDevice,
         stream_.Get());
    sift.ComputePatches(corners_.Data(),
                        num_jobs,
                        shape.patch_size,
                        patches_.Data(),
                        stream_.Get());
    ComputeMaps(shape, 1.0f);
  }

  // Waits for the batch, if there is one, and hands out its cost maps.
  void Finish(const PatchShape& shape, int num_threads) {
    if (outputs_of_jobs_.empty()) return;
    stream_.Wait();
    const size_t size = shape.NumCostElements();
    ParallelFor(outputs_of_jobs_.size(), num_threads, [&](size_t i) {
      std::memcpy(outputs_of_jobs_[i],
                  host_outputs_.Data() + i * size,
                  size * sizeof(uint16_t));
    });
    outputs_of_jobs_.clear();
  }

 private:
  // Finishes the batch before, and makes room for this one.
  void Begin(const PatchShape& shape,
             int64_t num_jobs,
             size_t host_patches_size,
             int num_threads) {
    Finish(shape, num_threads);
    const size_t count = static_cast<size_t>(num_jobs);
    const size_t references_size =
        count * static_cast<size_t>(shape.num_channels);
    host_patches_.Reserve(host_patches_size);
    patches_.Reserve(count * shape.NumElements());
    host_references_.Reserve(references_size);
    references_.Reserve(references_size);
    host_outputs_.Reserve(count * shape.NumCostElements());
    outputs_.Reserve(count * shape.NumCostElements());
    outputs_of_jobs_.resize(count);
  }

  void StageJob(const PatchShape& shape,
                size_t i,
                const uint16_t* reference,
                uint16_t* cost_map) {
    const size_t num_channels = static_cast<size_t>(shape.num_channels);
    std::memcpy(host_references_.Data() + i * num_channels,
                reference,
                num_channels * sizeof(uint16_t));
    outputs_of_jobs_[i] = cost_map;
  }

  // After the patches in the stream.
  void ComputeMaps(const PatchShape& shape, float inverse_pixel_size) {
    const size_t count = outputs_of_jobs_.size();
    const int64_t num_jobs = static_cast<int64_t>(count);
    Copy(references_.Data(),
         host_references_.Data(),
         count * static_cast<size_t>(shape.num_channels),
         cudaMemcpyHostToDevice,
         stream_.Get());
    ComputeMapsKernel<<<GpuLaunch::NumBlocks(num_jobs),
                        GpuLaunch::kBlockSize,
                        GpuLaunch::SharedBytes(shape),
                        stream_.Get()>>>(shape,
                                         inverse_pixel_size,
                                         patches_.Data(),
                                         references_.Data(),
                                         num_jobs,
                                         outputs_.Data());
    Check(cudaGetLastError(), "Launching the kernel of cost maps");
    Copy(host_outputs_.Data(),
         outputs_.Data(),
         count * shape.NumCostElements(),
         cudaMemcpyDeviceToHost,
         stream_.Get());
  }

  Buffer<uint16_t> host_patches_{Memory::kPinnedHost};
  Buffer<SiftCorner> host_corners_{Memory::kPinnedHost};
  Buffer<uint16_t> host_references_{Memory::kPinnedHost};
  Buffer<uint16_t> host_outputs_{Memory::kPinnedHost};
  Buffer<uint16_t> patches_{Memory::kDevice};
  Buffer<SiftCorner> corners_{Memory::kDevice};
  Buffer<uint16_t> references_{Memory::kDevice};
  Buffer<uint16_t> outputs_{Memory::kDevice};
  std::vector<uint16_t*> outputs_of_jobs_;
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
    sift_.emplace(num_threads);
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
    InBatches(shape, jobs, [&](BatchSlot* slot, size_t begin, int64_t count) {
      slot->Start(
          shape, inverse_pixel_size, jobs.data() + begin, count, num_threads_);
    });
  }

  bool ComputesSift() const override { return true; }
  std::unique_ptr<DeviceSift> LoadSift(const SiftImage& image) override;

 private:
  class LoadedSift;

  // The current GPU is a property of the calling thread.
  void UseGpu() const { Check(cudaSetDevice(gpu_index_), "Selecting the GPU"); }

  // Calls start(slot, begin, count) for batches of the jobs, and waits for all.
  template <typename Jobs, typename Function>
  void InBatches(const PatchShape& shape,
                 const Jobs& jobs,
                 const Function& start) {
    Prepare(shape);
    const int64_t num_jobs = static_cast<int64_t>(jobs.size());
    for (int64_t begin = 0; begin < num_jobs; begin += batch_size_) {
      start(&slots_[begin / batch_size_ % GpuLaunch::kNumStreams],
            static_cast<size_t>(begin),
            std::min(batch_size_, num_jobs - begin));
    }
    for (BatchSlot& slot : slots_) slot.Finish(shape, num_threads_);
  }

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
  std::optional<GpuSift> sift_;  // of this GPU: made when that is current
  std::deque<BatchSlot> slots_;
};

// The image is kept, what its descriptors are made of (tens of bytes per pixel)
// is computed again each time.
class GpuCostMapBackend::LoadedSift final : public DeviceSift {
 public:
  LoadedSift(GpuCostMapBackend* backend, const SiftImage& image)
      : backend_(backend),
        layout_(MakeSiftLayout(image.width, image.height, image.bin_size)) {
    backend_->UseGpu();
    backend_->sift_->CopyImage(image.grey, &grey_);
  }

  size_t NumBytes() const override {
    return static_cast<size_t>(layout_.width) * layout_.height * sizeof(float);
  }

  void Interpolate(const std::vector<DenseSiftKeypoint>& keypoints,
                   uint16_t* features) override {
    backend_->UseGpu();
    backend_->sift_->ComputeBins(layout_, grey_.Data());
    backend_->sift_->Interpolate(keypoints, features);
  }

  void ComputeMaps(int patch_size,
                   const std::vector<SiftMapJob>& jobs) override {
    backend_->UseGpu();
    backend_->sift_->ComputeBins(layout_, grey_.Data());
    const PatchShape shape = {patch_size, kNumSiftChannels};
    backend_->InBatches(
        shape, jobs, [&](BatchSlot* slot, size_t begin, int64_t count) {
          slot->Start(shape,
                      *backend_->sift_,
                      jobs.data() + begin,
                      count,
                      backend_->num_threads_);
        });
  }

 private:
  GpuCostMapBackend* backend_;
  const SiftLayout layout_;
  Buffer<float> grey_{Memory::kDevice};
};

std::unique_ptr<DeviceSift> GpuCostMapBackend::LoadSift(
    const SiftImage& image) {
  return std::make_unique<LoadedSift>(this, image);
}

}  // namespace

std::unique_ptr<CostMapBackend> CreateGpuCostMapBackend(int gpu_index,
                                                        int num_threads) {
  return std::make_unique<GpuCostMapBackend>(gpu_index, num_threads);
}

}  // namespace mfir
