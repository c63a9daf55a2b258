#include "colmap_ext/feature/sift_extractor.h"

#include <algorithm>
#include <vector>

#include "colmap_ext/host/image_file.h"
#include "src/feature/sift.h"

namespace mfir {
namespace {

SiftOptions Convert(const host::SiftExtractionOptions& source) {
  SiftOptions options;
  options.max_num_features = source.max_num_features;
  options.first_octave = source.first_octave;
  options.num_octaves = source.num_octaves;
  options.octave_resolution = source.octave_resolution;
  options.peak_threshold = source.peak_threshold;
  options.edge_threshold = source.edge_threshold;
  options.max_num_orientations = source.max_num_orientations;
  options.upright = source.upright;
  options.root = host::UsesRootSift(source);
  return options;
}

FloatImage Convert(const host::Bitmap& bitmap) {
  FloatImage image(bitmap.Width(), bitmap.Height());
  const std::vector<uint8_t> pixels = host::RowMajorData(bitmap);
  std::transform(
      pixels.begin(), pixels.end(), image.pixels.begin(), [](uint8_t value) {
        return static_cast<float>(value) / 255.0f;
      });
  return image;
}

class BuiltInSift : public host::FeatureExtractor {
 public:
  explicit BuiltInSift(const SiftOptions& options) : options_(options) {}

  bool Extract(const host::Bitmap& bitmap,
               host::FeatureKeypoints* keypoints,
               host::FeatureDescriptors* descriptors) override {
    const SiftFeatures features = ExtractSift(options_, Convert(bitmap));
    keypoints->clear();
    for (const SiftKeypoint& keypoint : features.keypoints) {
      keypoints->emplace_back(
          keypoint.x, keypoint.y, keypoint.sigma, keypoint.orientation);
    }
    *descriptors = host::MakeSiftDescriptors(keypoints->size());
    std::copy(features.descriptors.begin(),
              features.descriptors.end(),
              descriptors->data.data());
    return true;
  }

 private:
  const SiftOptions options_;
};

}  // namespace

bool BuiltInSiftSupports(const host::FeatureExtractionOptions& options) {
  const auto& sift = host::SiftExtraction(options);
  return host::IsSift(options) && !options.use_gpu &&
         !sift.estimate_affine_shape && !sift.domain_size_pooling;
}

std::unique_ptr<host::FeatureExtractor> MakeBuiltInSift(
    const host::FeatureExtractionOptions& options) {
  return std::make_unique<BuiltInSift>(Convert(host::SiftExtraction(options)));
}

}  // namespace mfir
