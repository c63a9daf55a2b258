// Dense SIFT by the functions of the CUDA kernels, on one thread of the CPU.

#pragma once

#include <memory>
#include <utility>
#include <vector>

#include "src/dense/cost_map_backend.h"
#include "src/dense/dense_sift_kernels.h"
#include "src/parallel/thread_group.h"

namespace mfir {

inline SiftLayout LayoutOf(const SiftImage& image) {
  return MakeSiftLayout(image.width, image.height, image.bin_size);
}

inline std::vector<float> SerialSiftBins(const SiftImage& image) {
  const SiftLayout layout = LayoutOf(image);
  std::vector<SiftGradient> gradients(layout.Gradients().NumPixels());
  ComputeSiftGradients(0, 1, layout, image.grey.data(), gradients.data());
  std::vector<float> row_sums(layout.RowSums().NumPixels() *
                              kNumSiftOrientations);
  ComputeSiftRowSums(0, 1, layout, gradients.data(), row_sums.data());
  std::vector<float> bins(layout.Bins().NumPixels() * kNumSiftOrientations);
  ComputeSiftBins(0, 1, layout, row_sums.data(), bins.data());
  return bins;
}

inline std::vector<uint16_t> SerialSiftPatches(
    const SiftImage& image,
    const std::vector<SiftCorner>& corners,
    int patch_size) {
  const std::vector<float> bins = SerialSiftBins(image);
  const size_t size = PatchShape{patch_size, kNumSiftChannels}.NumElements();
  std::vector<uint16_t> patches(corners.size() * size);
  for (size_t i = 0; i < corners.size(); ++i) {
    ComputeSiftPatch(SerialGroup(),
                     0,
                     1,
                     LayoutOf(image),
                     bins.data(),
                     corners[i],
                     patch_size,
                     &patches[i * size]);
  }
  return patches;
}

class SerialSift : public DeviceSift {
 public:
  explicit SerialSift(SiftImage image) : image_(std::move(image)) {}

  size_t NumBytes() const override {
    return image_.grey.size() * sizeof(float);
  }

  void Interpolate(const std::vector<DenseSiftKeypoint>& keypoints,
                   uint16_t* features) override {
    const std::vector<float> bins = SerialSiftBins(image_);
    for (size_t i = 0; i < keypoints.size(); ++i) {
      InterpolateSiftFeature(SerialGroup(),
                             LayoutOf(image_),
                             bins.data(),
                             keypoints[i],
                             features + i * kNumSiftChannels);
    }
  }

  void ComputeMaps(int patch_size,
                   const std::vector<SiftMapJob>& jobs) override {
    const PatchShape shape = {patch_size, kNumSiftChannels};
    std::vector<SiftCorner> corners;
    for (const SiftMapJob& job : jobs) corners.push_back(job.corner);
    const std::vector<uint16_t> patches =
        SerialSiftPatches(image_, corners, patch_size);
    std::vector<CostMapJob> map_jobs;
    for (size_t i = 0; i < jobs.size(); ++i) {
      map_jobs.push_back({&patches[i * shape.NumElements()],
                          jobs[i].reference,
                          jobs[i].cost_map});
    }
    CreateCpuCostMapBackend(1)->ComputeMaps(shape, 1.0f, map_jobs);
  }

 private:
  const SiftImage image_;
};

}  // namespace mfir
