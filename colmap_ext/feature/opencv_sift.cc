#include "colmap_ext/feature/opencv_sift.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include <opencv2/core.hpp>
#include <opencv2/features2d.hpp>

#include "colmap_ext/host/image_file.h"
#include "src/feature/descriptor_products.h"

namespace mfir {
namespace {

// OpenCV doubles the image such that pixel i of the result is centred at
// i / 2 - 1 / 4 of the original's pixels, but takes it for i / 2. In COLMAP the
// centre of pixel 0 is at 0.5.
constexpr float kPixelOffset = 0.5f - 0.25f;
// Of the scale space, relative to the pixels of each octave: as in VLFeat.
constexpr double kSigma = 1.6;
constexpr int kFirstOctave = -1;

// Octaves are halved by leaving out every other pixel. Where a side is odd,
// OpenCV's step is a little more than 2, which would move keypoints.
cv::Mat PadToWholeOctaves(const cv::Mat& image, int num_octaves) {
  const int multiple = 1 << std::clamp(num_octaves + kFirstOctave - 1, 0, 6);
  const auto missing = [multiple](int size) {
    return (multiple - size % multiple) % multiple;
  };
  cv::Mat padded;
  cv::copyMakeBorder(image,
                     padded,
                     0,
                     missing(image.rows),
                     0,
                     missing(image.cols),
                     cv::BORDER_REPLICATE);
  return padded;
}

int Octave(const cv::KeyPoint& keypoint) {
  return static_cast<signed char>(keypoint.octave & 0xff);
}

// COLMAP's default: square root of the L1-normalised descriptor. The layout is
// that of COLMAP already.
void WriteRootDescriptor(const float* descriptor, uint8_t* bytes) {
  float sum = 0.0f;
  for (size_t i = 0; i < kSiftDescriptorSize; ++i) sum += descriptor[i];
  const float scale = 512.0f * 512.0f / std::max(sum, 1e-6f);
  for (size_t i = 0; i < kSiftDescriptorSize; ++i) {
    bytes[i] = static_cast<uint8_t>(
        std::min(std::round(std::sqrt(scale * descriptor[i])), 255.0f));
  }
}

void WriteDescriptor(const float* descriptor, uint8_t* bytes) {
  float squared_norm = 0.0f;
  for (size_t i = 0; i < kSiftDescriptorSize; ++i) {
    squared_norm += descriptor[i] * descriptor[i];
  }
  const float scale = 512.0f / std::sqrt(std::max(squared_norm, 1e-6f));
  for (size_t i = 0; i < kSiftDescriptorSize; ++i) {
    bytes[i] = static_cast<uint8_t>(
        std::min(std::round(scale * descriptor[i]), 255.0f));
  }
}

class OpenCVSift : public host::FeatureExtractor {
 public:
  explicit OpenCVSift(const host::FeatureExtractionOptions& options)
      : sift_options_(host::SiftExtraction(options)) {
    // Images are shared out to threads already.
    cv::setNumThreads(1);
  }

  bool Extract(const host::Bitmap& bitmap,
               host::FeatureKeypoints* keypoints,
               host::FeatureDescriptors* descriptors) override {
    std::vector<uint8_t> pixels = host::RowMajorData(bitmap);
    const cv::Mat image = PadToWholeOctaves(
        cv::Mat(bitmap.Height(), bitmap.Width(), CV_8UC1, pixels.data()),
        sift_options_.num_octaves);
    std::vector<cv::KeyPoint> found;
    cv::Mat found_descriptors;
    cv::SIFT::create(
        sift_options_.max_num_features,
        sift_options_.octave_resolution,
        sift_options_.peak_threshold * sift_options_.octave_resolution,
        sift_options_.edge_threshold,
        kSigma)
        ->detectAndCompute(image, cv::noArray(), found, found_descriptors);
    Select(bitmap.Width(),
           bitmap.Height(),
           found,
           found_descriptors,
           keypoints,
           descriptors);
    return true;
  }

 private:
  bool IsWanted(const cv::KeyPoint& keypoint, int width, int height) const {
    return Octave(keypoint) < kFirstOctave + sift_options_.num_octaves &&
           keypoint.pt.x + kPixelOffset < static_cast<float>(width) &&
           keypoint.pt.y + kPixelOffset < static_cast<float>(height);
  }

  void Select(int width,
              int height,
              const std::vector<cv::KeyPoint>& found,
              const cv::Mat& found_descriptors,
              host::FeatureKeypoints* keypoints,
              host::FeatureDescriptors* descriptors) const {
    keypoints->clear();
    *descriptors = host::MakeSiftDescriptors(found.size());
    int num_orientations = 0;
    for (size_t i = 0; i < found.size(); ++i) {
      const cv::KeyPoint& keypoint = found[i];
      // Those that differ in the orientation only follow one another.
      const bool is_same = i > 0 && keypoint.pt == found[i - 1].pt &&
                           keypoint.size == found[i - 1].size;
      num_orientations = is_same ? num_orientations + 1 : 1;
      if (num_orientations > sift_options_.max_num_orientations ||
          !IsWanted(keypoint, width, height)) {
        continue;
      }
      uint8_t* bytes = descriptors->data.row(keypoints->size()).data();
      const float* descriptor = found_descriptors.ptr<float>(i);
      if (host::UsesRootSift(sift_options_)) {
        WriteRootDescriptor(descriptor, bytes);
      } else {
        WriteDescriptor(descriptor, bytes);
      }
      keypoints->emplace_back(keypoint.pt.x + kPixelOffset,
                              keypoint.pt.y + kPixelOffset,
                              0.5f * keypoint.size,
                              keypoint.angle * static_cast<float>(M_PI / 180));
    }
    descriptors->data.conservativeResize(keypoints->size(),
                                         kSiftDescriptorSize);
  }

  const host::SiftExtractionOptions sift_options_;
};

}  // namespace

bool OpenCVSiftSupports(const host::FeatureExtractionOptions& options) {
  const auto& sift = host::SiftExtraction(options);
  return host::IsSift(options) && !options.use_gpu &&
         sift.first_octave == kFirstOctave && !sift.upright &&
         !sift.estimate_affine_shape && !sift.domain_size_pooling;
}

std::unique_ptr<host::FeatureExtractor> MakeOpenCVSift(
    const host::FeatureExtractionOptions& options) {
  return std::make_unique<OpenCVSift>(options);
}

}  // namespace mfir
