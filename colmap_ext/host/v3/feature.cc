#include "colmap_ext/host/feature.h"

#include "SiftGPU/SiftGPU.h"
#include "util/cuda.h"

namespace mfir::host {
namespace {

class SiftExtractor : public FeatureExtractor {
 public:
  explicit SiftExtractor(const FeatureExtractionOptions& options)
      : options_(options) {}

  // False if there is no such GPU.
  bool SetUp() {
    if (IsCovariant() || !options_.use_gpu) return true;
    sift_gpu_ = std::make_unique<SiftGPU>();
    return colmap::CreateSiftGPUExtractor(options_, sift_gpu_.get());
  }

  bool Extract(const Bitmap& bitmap,
               FeatureKeypoints* keypoints,
               FeatureDescriptors* descriptors) override {
    if (IsCovariant()) {
      return colmap::ExtractCovariantSiftFeaturesCPU(
          options_, bitmap, keypoints, &descriptors->data);
    }
    if (sift_gpu_ != nullptr) {
      return colmap::ExtractSiftFeaturesGPU(
          options_, bitmap, sift_gpu_.get(), keypoints, &descriptors->data);
    }
    return colmap::ExtractSiftFeaturesCPU(
        options_, bitmap, keypoints, &descriptors->data);
  }

 private:
  bool IsCovariant() const {
    return options_.estimate_affine_shape || options_.domain_size_pooling;
  }

  const FeatureExtractionOptions options_;
  std::unique_ptr<SiftGPU> sift_gpu_;  // null: on the CPU
};

class SiftMatcher : public FeatureMatcher {
 public:
  explicit SiftMatcher(const FeatureMatchingOptions& options)
      : options_(options) {}

  bool SetUp() {
    if (!options_.use_gpu) return true;
    sift_gpu_ = std::make_unique<SiftMatchGPU>();
    return colmap::CreateSiftGPUMatcher(options_, sift_gpu_.get());
  }

  void Match(const Image& image1,
             const Image& image2,
             FeatureMatches* matches) override {
    if (sift_gpu_ != nullptr) {
      colmap::MatchSiftFeaturesGPU(options_,
                                   &image1.descriptors->data,
                                   &image2.descriptors->data,
                                   sift_gpu_.get(),
                                   matches);
    } else {
      colmap::MatchSiftFeaturesCPU(options_,
                                   image1.descriptors->data,
                                   image2.descriptors->data,
                                   matches);
    }
  }

 private:
  const FeatureMatchingOptions options_;
  std::unique_ptr<SiftMatchGPU> sift_gpu_;  // null: on the CPU
};

}  // namespace

void SetFeatureTypes(const FeatureTypes& /*types*/,
                     FeatureExtractionOptions* /*extraction*/,
                     FeatureMatchingOptions* /*matching*/) {}

std::unique_ptr<FeatureExtractor> FeatureExtractor::Create(
    const FeatureExtractionOptions& options) {
  auto extractor = std::make_unique<SiftExtractor>(options);
  if (!extractor->SetUp()) return nullptr;
  return extractor;
}

std::unique_ptr<FeatureMatcher> FeatureMatcher::Create(
    const FeatureMatchingOptions& options) {
  auto matcher = std::make_unique<SiftMatcher>(options);
  if (!matcher->SetUp()) return nullptr;
  return matcher;
}

bool RequiresRGB(const FeatureExtractionOptions&) { return false; }

int EffMaxImageSize(const FeatureExtractionOptions& options) {
  return options.max_image_size;
}

// FLANN's index of an image is part of each match.
struct FeatureMatcherIndex::Impl {};

FeatureMatcherIndex::FeatureMatcherIndex(size_t, const Descriptors&) {}

FeatureMatcherIndex::~FeatureMatcherIndex() = default;

std::unique_ptr<FeatureMatcher> FeatureMatcherIndex::CreateMatcher(
    const FeatureMatchingOptions& options) const {
  return FeatureMatcher::Create(options);
}

bool HasGpuFeatures() {
#ifdef CUDA_ENABLED
  return colmap::GetNumCudaDevices() > 0;
#else
  return false;
#endif
}

}  // namespace mfir::host
