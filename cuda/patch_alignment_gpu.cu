#include "cuda/patch_alignment_gpu.h"

#include <cstddef>
#include <string>
#include <vector>

#include <cuda_runtime.h>

#include "cuda/cuda_calls.h"

namespace mfir {
namespace {

template <typename Result>
__global__ void __launch_bounds__(PatchLaunch::kBlockSize)
    RunJobsKernel(const PatchDisc* disc,
                  const PatchTemplate* templates,
                  const SplineView* images,
                  const PatchJob* jobs,
                  int64_t num_jobs,
                  Result* results) {
  __shared__ float scratch[PatchLaunch::kWarpsPerBlock][kPatchScratchSize];
  const int warp = static_cast<int>(threadIdx.x) / WarpGroup::Size();
  RunPatchJobs(
      WarpGroup{static_cast<int>(threadIdx.x) % WarpGroup::Size()},
      static_cast<int64_t>(blockIdx.x) * PatchLaunch::kWarpsPerBlock + warp,
      static_cast<int64_t>(gridDim.x) * PatchLaunch::kWarpsPerBlock,
      *disc,
      templates,
      images,
      jobs,
      num_jobs,
      scratch[warp],
      results);
}

class GpuPatchBackend final : public PatchBackend {
 public:
  explicit GpuPatchBackend(int gpu_index)
      : gpu_index_(ChooseGpu(gpu_index, &name_)) {
    UseGpu();
    // A GPU whose driver or architecture does not fit fails here at the latest.
    cudaFuncAttributes attributes;
    Check(cudaFuncGetAttributes(&attributes, RunJobsKernel<AlignedPatch>),
          "Loading the kernels");
    const PatchDisc disc = MakePatchDisc();
    Upload(&disc, 1, &disc_);
    stream_.Wait();
  }

  std::string Name() const override { return name_; }

  // All in one piece of memory, once per frame.
  void SetImages(const std::vector<SplineImage>& images) override {
    UseGpu();
    size_t size = 0;
    for (const SplineImage& image : images) size += NumCoefficients(image);
    coefficients_.Reserve(size);
    std::vector<SplineView> views;
    float* end = coefficients_.Data();
    for (const SplineImage& image : images) {
      views.push_back(image.View());
      const size_t count = NumCoefficients(image);
      if (count == 0) continue;  // no image, and no jobs
      Copy(end,
           views.back().coefficients,
           count,
           cudaMemcpyHostToDevice,
           stream_.Get());
      views.back().coefficients = end;
      end += count;
    }
    Upload(views.data(), views.size(), &views_);
    stream_.Wait();
  }

  void SetTemplates(const std::vector<PatchTemplate>& templates) override {
    UseGpu();
    Upload(templates.data(), templates.size(), &templates_);
  }

  void Fit(const std::vector<PatchJob>& jobs,
           std::vector<PatchFit>* results) override {
    Run(jobs, &fits_, results);
  }
  void Align(const std::vector<PatchJob>& jobs,
             std::vector<AlignedPatch>* results) override {
    Run(jobs, &aligned_, results);
  }
  void Search(const std::vector<PatchJob>& jobs,
              std::vector<FoundPatch>* results) override {
    Run(jobs, &found_, results);
  }

 private:
  // The current GPU is a property of the calling thread.
  void UseGpu() const { Check(cudaSetDevice(gpu_index_), "Selecting the GPU"); }

  static size_t NumCoefficients(const SplineImage& image) {
    const SplineView view = image.View();
    return static_cast<size_t>(view.width) * static_cast<size_t>(view.height);
  }

  template <typename T>
  void Upload(const T* source, size_t count, Buffer<T>* target) {
    target->Reserve(count);
    Copy(target->Data(), source, count, cudaMemcpyHostToDevice, stream_.Get());
  }

  // In batches, one after another: 100 bytes per patch, which take far longer
  // to align than to copy.
  template <typename Result>
  void Run(const std::vector<PatchJob>& jobs,
           Buffer<Result>* gpu_results,
           std::vector<Result>* results) {
    UseGpu();
    results->resize(jobs.size());
    const int64_t num_jobs = static_cast<int64_t>(jobs.size());
    for (int64_t begin = 0; begin < num_jobs;
         begin += PatchLaunch::kMaxNumJobs) {
      const int64_t count =
          std::min(PatchLaunch::kMaxNumJobs, num_jobs - begin);
      Upload(jobs.data() + begin, static_cast<size_t>(count), &jobs_);
      gpu_results->Reserve(static_cast<size_t>(count));
      RunJobsKernel<<<PatchLaunch::NumBlocks(count),
                      PatchLaunch::kBlockSize,
                      0,
                      stream_.Get()>>>(disc_.Data(),
                                       templates_.Data(),
                                       views_.Data(),
                                       jobs_.Data(),
                                       count,
                                       gpu_results->Data());
      Check(cudaGetLastError(), "Launching the kernel of patches");
      Copy(results->data() + begin,
           gpu_results->Data(),
           static_cast<size_t>(count),
           cudaMemcpyDeviceToHost,
           stream_.Get());
      stream_.Wait();
    }
  }

  std::string name_;
  const int gpu_index_;
  Buffer<PatchDisc> disc_{Memory::kDevice};
  Buffer<float> coefficients_{Memory::kDevice};
  Buffer<SplineView> views_{Memory::kDevice};
  Buffer<PatchTemplate> templates_{Memory::kDevice};
  Buffer<PatchJob> jobs_{Memory::kDevice};
  Buffer<PatchFit> fits_{Memory::kDevice};
  Buffer<AlignedPatch> aligned_{Memory::kDevice};
  Buffer<FoundPatch> found_{Memory::kDevice};
  Stream stream_;  // last: waited for before the buffers go
};

}  // namespace

std::unique_ptr<PatchBackend> CreateGpuPatchBackend(int gpu_index) {
  return std::make_unique<GpuPatchBackend>(gpu_index);
}

}  // namespace mfir
