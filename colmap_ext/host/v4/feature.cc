#include "colmap_ext/host/feature.h"

#include "colmap/feature/index.h"
#include "colmap/util/cache.h"
#include "colmap/util/cuda.h"
#include "src/util/errors.h"

namespace mfir::host {
namespace {

using colmap::FeatureMatcherType;

// `from_name` is COLMAP's, which throws.
template <typename FromName>
auto TypeOf(const std::string& option,
            const std::string& name,
            const FromName& from_name) {
  try {
    return from_name(name);
  } catch (const std::exception&) {
    throw UsageError("--" + option + " " + name +
                     " does not exist. See --help.");
  }
}

void RequireOnnx([[maybe_unused]] const std::string& option,
                 [[maybe_unused]] const std::string& name) {
#ifndef COLMAP_ONNX_ENABLED
  throw UsageError("--" + option + " " + name +
                   " needs a COLMAP that is built with ONNX, which this one is "
                   "not. Leave the option out, or configure the build with "
                   "-DONNX_ENABLED=ON.");
#endif
}

}  // namespace

void SetFeatureTypes(const FeatureTypes& types,
                     FeatureExtractionOptions* extraction,
                     FeatureMatchingOptions* matching) {
  const std::string extractor_option = "FeatureExtraction.type";
  const std::string matcher_option = "FeatureMatching.type";
  extraction->type = TypeOf(extractor_option,
                            types.extractor,
                            colmap::FeatureExtractorTypeFromString);
  const bool is_sift = IsSift(*extraction);
  if (!is_sift) RequireOnnx(extractor_option, types.extractor);
  if (types.matcher.empty()) {
    matching->type = is_sift ? FeatureMatcherType::SIFT_BRUTEFORCE
                             : FeatureMatcherType::ALIKED_LIGHTGLUE;
    return;
  }
  matching->type = TypeOf(
      matcher_option, types.matcher, colmap::FeatureMatcherTypeFromString);
  if (!MatchesNearestSift(*matching)) {
    RequireOnnx(matcher_option, types.matcher);
  }
  const bool takes_sift = MatchesNearestSift(*matching) ||
                          matching->type == FeatureMatcherType::SIFT_LIGHTGLUE;
  if (takes_sift != is_sift) {
    throw UsageError("--" + matcher_option + " " + types.matcher +
                     " cannot match features of --" + extractor_option + " " +
                     types.extractor + ".");
  }
}

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
