#include "colmap_ext/frames/frame_features.h"

#include <algorithm>
#include <atomic>
#include <map>
#include <optional>

#include "colmap_ext/feature/sift_extractor.h"
#include "colmap_ext/models/model_io.h"
#include "colmap_ext/rigs/rig_scaling.h"
#include "src/parallel/parallel_for.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

std::string Size(const host::Bitmap& bitmap) {
  return std::to_string(bitmap.Width()) + " x " +
         std::to_string(bitmap.Height()) + " pixels";
}

// Without this, keypoints beyond the mask would be dropped.
void CheckMaskSize(const std::string& mask_path,
                   const host::Bitmap& mask,
                   const std::string& image_path,
                   const host::Bitmap& image) {
  if (mask.Width() == image.Width() && mask.Height() == image.Height()) return;
  throw InputError(mask_path + " has " + Size(mask) + ", but the image " +
                   image_path + " has " + Size(image) +
                   ". Give masks of the size of the images.");
}

// Drops the features on black pixels.
void MaskFeatures(const host::Bitmap& mask, FrameFeatures* features) {
  host::FeatureKeypoints& keypoints = *features->keypoints;
  auto& descriptors = features->descriptors->data;
  size_t num_kept = 0;
  for (size_t i = 0; i < keypoints.size(); ++i) {
    if (host::PixelOrBlack(mask,
                           static_cast<int>(keypoints[i].x),
                           static_cast<int>(keypoints[i].y)) == 0) {
      continue;
    }
    keypoints[num_kept] = keypoints[i];
    descriptors.row(num_kept) = descriptors.row(i).eval();
    ++num_kept;
  }
  keypoints.resize(num_kept);
  descriptors.conservativeResize(num_kept, descriptors.cols());
}

class FeatureExtraction {
 public:
  FeatureExtraction(const TriangulatorOptions& options,
                    const std::vector<RigCamera>& cameras)
      : options_(options.feature_extraction),
        cameras_(cameras),
        camera_mask_path_(options.camera_mask_path) {
    if (camera_mask_path_.empty()) return;
    if (!camera_mask_.emplace().Read(camera_mask_path_, /*as_rgb=*/false)) {
      throw InputError("--ImageReader.camera_mask_path " + camera_mask_path_ +
                       ": cannot read the mask.");
    }
  }

  // Keypoints are null if the image cannot be read.
  FrameFeatures Run(const FrameImageFile& file,
                    host::FeatureExtractor* extractor) const {
    FrameFeatures features{file.camera_idx, file.name, nullptr, nullptr};
    host::Bitmap bitmap;
    if (!bitmap.Read(file.path, host::RequiresRGB(options_))) return features;
    CheckSize(file, bitmap);
    const std::optional<host::Bitmap> mask = ReadMask(file, bitmap);
    if (camera_mask_) {
      CheckMaskSize("--ImageReader.camera_mask_path " + camera_mask_path_,
                    *camera_mask_,
                    file.name,
                    bitmap);
    }
    Extract(cameras_[file.camera_idx], extractor, &bitmap, &features);
    if (camera_mask_) MaskFeatures(*camera_mask_, &features);
    if (mask) MaskFeatures(*mask, &features);
    return features;
  }

 private:
  void CheckSize(const FrameImageFile& file, const host::Bitmap& bitmap) const {
    const RigCamera& camera = cameras_[file.camera_idx];
    if (static_cast<size_t>(bitmap.Width()) == camera.width &&
        static_cast<size_t>(bitmap.Height()) == camera.height) {
      return;
    }
    throw InputError(
        file.path + " has " + Size(bitmap) +
        ", but the intrinsics of camera '" + camera.name + "' are for " +
        std::to_string(camera.width) + " x " + std::to_string(camera.height) +
        ". " +
        ImageSizeAdvice(
            bitmap.Width(), bitmap.Height(), camera.width, camera.height));
  }

  static std::optional<host::Bitmap> ReadMask(const FrameImageFile& file,
                                              const host::Bitmap& bitmap) {
    std::optional<host::Bitmap> mask;
    if (file.mask_path.empty()) return mask;
    if (!mask.emplace().Read(file.mask_path, /*as_rgb=*/false)) {
      throw InputError(file.mask_path +
                       ": cannot read the mask. Replace or remove it.");
    }
    CheckMaskSize(file.mask_path, *mask, file.path, bitmap);
    return mask;
  }

  // In the pixels of the camera. No features where the extractor fails.
  void Extract(const RigCamera& camera,
               host::FeatureExtractor* extractor,
               host::Bitmap* bitmap,
               FrameFeatures* features) const {
    features->keypoints = std::make_shared<host::FeatureKeypoints>();
    features->descriptors = std::make_shared<host::FeatureDescriptors>();
    host::Thumbnail(host::EffMaxImageSize(options_), bitmap);
    if (!extractor->Extract(
            *bitmap, features->keypoints.get(), features->descriptors.get())) {
      features->keypoints->clear();
      features->descriptors->data.resize(0, features->descriptors->data.cols());
      return;
    }
    const float scale_x = static_cast<float>(camera.width) / bitmap->Width();
    const float scale_y = static_cast<float>(camera.height) / bitmap->Height();
    if (scale_x == 1.0f && scale_y == 1.0f) return;
    for (host::FeatureKeypoint& keypoint : *features->keypoints) {
      keypoint.Rescale(scale_x, scale_y);
    }
  }

  const host::FeatureExtractionOptions& options_;
  const std::vector<RigCamera>& cameras_;
  const std::string camera_mask_path_;
  std::optional<host::Bitmap> camera_mask_;
};

// Throws where COLMAP returned none.
template <typename T>
std::unique_ptr<T> CheckCreated(std::unique_ptr<T> object, const char* what) {
  if (object == nullptr) {
    throw InputError(std::string("COLMAP cannot make the ") + what +
                     " that the options ask for on this machine.");
  }
  return object;
}

std::unique_ptr<host::FeatureExtractor> MakeExtractor(
    const TriangulatorOptions& options) {
  if (options.feature_extractor == "built_in" &&
      BuiltInSiftSupports(options.feature_extraction)) {
    return MakeBuiltInSift(options.feature_extraction);
  }
  return CheckCreated(
      host::FeatureExtractor::Create(options.feature_extraction),
      "feature extractor");
}

// A GPU is shared by what runs on it: one thread keeps it busy.
int NumWorkers(bool use_gpu, int num_threads) {
  return use_gpu ? 1 : std::max(1, num_threads);
}

}  // namespace

std::vector<FrameFeatures> ExtractFeatures(
    const TriangulatorOptions& options,
    const std::vector<RigCamera>& cameras,
    const std::vector<FrameImageFile>& files,
    int num_threads,
    const ProgressFunction& progress,
    std::vector<std::string>* warnings) {
  const FeatureExtraction extraction(options, cameras);
  std::vector<FrameFeatures> results(files.size());
  std::atomic<size_t> num_done = 0;
  ParallelForWithWorkers(
      files.size(),
      NumWorkers(options.feature_extraction.use_gpu, num_threads),
      [&]() { return MakeExtractor(options); },
      [&](const std::unique_ptr<host::FeatureExtractor>& extractor, size_t i) {
        results[i] = extraction.Run(files[i], extractor.get());
        const size_t num = ++num_done;
        if (progress) progress(num, files.size());
      });
  std::vector<FrameFeatures> features;
  for (size_t i = 0; i < files.size(); ++i) {
    if (results[i].keypoints != nullptr) {
      features.push_back(std::move(results[i]));
    } else {
      warnings->push_back(files[i].path +
                          ": cannot read the image; it is left out");
    }
  }
  std::sort(features.begin(),
            features.end(),
            [](const FrameFeatures& a, const FrameFeatures& b) {
              return a.camera_idx < b.camera_idx;
            });
  return features;
}

std::vector<FrameMatches> MatchFeatures(
    const TriangulatorOptions& options,
    const std::vector<RigCamera>& cameras,
    const std::vector<FrameFeatures>& features,
    const std::vector<std::pair<size_t, size_t>>& pairs,
    int num_threads) {
  using MatcherImage = host::FeatureMatcher::Image;
  std::map<size_t, host::Camera> host_cameras;
  std::map<size_t, MatcherImage> images;
  for (const FrameFeatures& image : features) {
    const auto id = static_cast<host::image_t>(image.camera_idx + 1);
    MatcherImage matcher_image;
    matcher_image.image_id = id;
    // LightGlue reads the size of the image.
    matcher_image.camera =
        &host_cameras
             .emplace(image.camera_idx,
                      MakeHostCamera(id, cameras[image.camera_idx]))
             .first->second;
    matcher_image.keypoints = image.keypoints;
    matcher_image.descriptors = image.descriptors;
    images.emplace(image.camera_idx, matcher_image);
  }
  std::vector<FrameMatches> results;
  for (const auto& [idx1, idx2] : pairs) {
    if (images.count(idx1) == 0 || images.count(idx2) == 0) continue;
    results.push_back({idx1, idx2, {}});
  }
  std::sort(results.begin(),
            results.end(),
            [](const FrameMatches& a, const FrameMatches& b) {
              return std::make_pair(a.camera_idx1, a.camera_idx2) <
                     std::make_pair(b.camera_idx1, b.camera_idx2);
            });
  const host::FeatureMatcherIndex index(
      features.size(), [&images](host::image_t image_id) {
        return images.at(image_id - 1).descriptors;
      });
  ParallelForWithWorkers(
      results.size(),
      NumWorkers(options.feature_matching.use_gpu, num_threads),
      [&]() {
        return CheckCreated(index.CreateMatcher(options.feature_matching),
                            "feature matcher");
      },
      [&](const std::unique_ptr<host::FeatureMatcher>& matcher, size_t i) {
        matcher->Match(images.at(results[i].camera_idx1),
                       images.at(results[i].camera_idx2),
                       &results[i].matches);
      });
  return results;
}

}  // namespace mfir
