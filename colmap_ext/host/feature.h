// COLMAP's feature extraction and matching as objects, one per thread, made
// from options: the factories of COLMAP 4. In 3.8 there is SIFT only.

#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "colmap_ext/host/camera.h"
#include "colmap_ext/host/image_file.h"

#if MFIR_COLMAP_MAJOR >= 4
#include "colmap/feature/aliked.h"
#include "colmap/feature/extractor.h"
#include "colmap/feature/matcher.h"
#include "colmap/feature/sift.h"
#include "colmap/feature/types.h"
#else
#include "feature/sift.h"
#include "feature/types.h"
#endif

namespace mfir::host {

using colmap::FeatureKeypoint;
using colmap::FeatureKeypoints;
using colmap::FeatureMatch;
using colmap::FeatureMatches;
using colmap::image_t;
using colmap::SiftExtractionOptions;

#if MFIR_COLMAP_MAJOR >= 4
using colmap::FeatureDescriptors;
using colmap::FeatureExtractionOptions;
using colmap::FeatureExtractor;
using colmap::FeatureMatcher;
using colmap::FeatureMatchingOptions;
#else
using FeatureExtractionOptions = colmap::SiftExtractionOptions;
using FeatureMatchingOptions = colmap::SiftMatchingOptions;

struct FeatureDescriptors {
  Eigen::Matrix<uint8_t, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> data;
};

class FeatureExtractor {
 public:
  virtual ~FeatureExtractor() = default;
  static std::unique_ptr<FeatureExtractor> Create(
      const FeatureExtractionOptions& options);
  // Keypoints are in the pixels of `bitmap`.
  virtual bool Extract(const Bitmap& bitmap,
                       FeatureKeypoints* keypoints,
                       FeatureDescriptors* descriptors) = 0;
};

class FeatureMatcher {
 public:
  struct Image {
    image_t image_id = 0;
    const Camera* camera = nullptr;
    std::shared_ptr<const FeatureKeypoints> keypoints;
    std::shared_ptr<const FeatureDescriptors> descriptors;
  };

  virtual ~FeatureMatcher() = default;
  static std::unique_ptr<FeatureMatcher> Create(
      const FeatureMatchingOptions& options);
  virtual void Match(const Image& image1,
                     const Image& image2,
                     FeatureMatches* matches) = 0;
};
#endif

// Zeros: that many descriptors of SIFT.
inline FeatureDescriptors MakeSiftDescriptors(size_t num_descriptors) {
  FeatureDescriptors descriptors;
#if MFIR_COLMAP_MAJOR >= 4
  descriptors.type = colmap::FeatureExtractorType::SIFT;
#endif
  descriptors.data.setZero(static_cast<Eigen::Index>(num_descriptors), 128);
  return descriptors;
}

inline bool IsSift([[maybe_unused]] const FeatureExtractionOptions& options) {
#if MFIR_COLMAP_MAJOR >= 4
  return options.type == colmap::FeatureExtractorType::SIFT;
#else
  return true;
#endif
}

// By the names of COLMAP 4, as the user gives them.
struct FeatureTypes {
  std::string extractor = "SIFT";
  std::string matcher;  // empty: the one that goes with the extractor
};

// Sets the types in both. Throws UsageError for names that do not exist, a
// matcher of other features, and what the host was built without.
void SetFeatureTypes(const FeatureTypes& types,
                     FeatureExtractionOptions* extraction,
                     FeatureMatchingOptions* matching);

// Whether matches are nearest neighbours of SIFT's descriptors.
inline bool MatchesNearestSift(
    [[maybe_unused]] const FeatureMatchingOptions& options) {
#if MFIR_COLMAP_MAJOR >= 4
  return options.type == colmap::FeatureMatcherType::SIFT_BRUTEFORCE;
#else
  return true;
#endif
}

// Whether descriptors are square roots of L1-normalised ones.
inline bool UsesRootSift(const SiftExtractionOptions& options) {
  return options.normalization == SiftExtractionOptions::Normalization::L1_ROOT;
}

// Whether images have to be read in color.
bool RequiresRGB(const FeatureExtractionOptions& options);

// The larger side to which COLMAP shrinks images, pixels.
int EffMaxImageSize(const FeatureExtractionOptions& options);

// The options of SIFT among them.
#if MFIR_COLMAP_MAJOR >= 4
inline auto& SiftExtraction(const FeatureExtractionOptions& options) {
  return *options.sift;
}
inline auto& SiftMatching(const FeatureMatchingOptions& options) {
  return *options.sift;
}
#else
template <typename Options>
Options& SiftExtraction(Options& options) {
  return options;
}
template <typename Options>
Options& SiftMatching(Options& options) {
  return options;
}
#endif

// Prepares the descriptors of images for the matchers of several threads,
// where the version has such a thing.
class FeatureMatcherIndex {
 public:
  using Descriptors =
      std::function<std::shared_ptr<const FeatureDescriptors>(image_t)>;
  FeatureMatcherIndex(size_t num_images, const Descriptors& descriptors);
  ~FeatureMatcherIndex();

  // nullptr where the host cannot match so here. This object must outlive it.
  std::unique_ptr<FeatureMatcher> CreateMatcher(
      const FeatureMatchingOptions& options) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

// Whether features can be computed on a GPU here. COLMAP's OpenGL variant needs
// a window system and the main thread, and is not used.
bool HasGpuFeatures();

}  // namespace mfir::host
