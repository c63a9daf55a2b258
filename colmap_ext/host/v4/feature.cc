#include "colmap_ext/host/feature.h"

#include "colmap/feature/index.h"
#include "colmap/util/cache.h"
#include "colmap/util/cuda.h"

namespace mfir::host {

bool RequiresRGB(const FeatureExtractionOptions& options) {
  return options.RequiresRGB();
}

int EffMaxImageSize(const FeatureExtractionOptions& options) {
  return options.EffMaxImageSize();
}

struct FeatureMatcherIndex::Impl {
  colmap::ThreadSafeLRUCache<image_t, colmap::FeatureDescriptorIndex> cache;

  Impl(size_t num_images, const Descriptors& descriptors)
      : cache(num_images, [descriptors](image_t image_id) {
          std::shared_ptr<colmap::FeatureDescriptorIndex> index =
              colmap::FeatureDescriptorIndex::Create();
          index->Build(descriptors(image_id)->ToFloat());
          return index;
        }) {}
};

FeatureMatcherIndex::FeatureMatcherIndex(size_t num_images,
                                         const Descriptors& descriptors)
    : impl_(std::make_unique<Impl>(num_images, descriptors)) {}

FeatureMatcherIndex::~FeatureMatcherIndex() = default;

std::unique_ptr<FeatureMatcher> FeatureMatcherIndex::CreateMatcher(
    const FeatureMatchingOptions& options) const {
  FeatureMatchingOptions with_index = options;
  with_index.sift->cpu_descriptor_index_cache = &impl_->cache;
  return FeatureMatcher::Create(with_index);
}

bool HasGpuFeatures() {
#ifdef COLMAP_CUDA_ENABLED
  return colmap::GetNumCudaDevices() > 0;
#else
  return false;
#endif
}

}  // namespace mfir::host
