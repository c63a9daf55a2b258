// Dense feature patches around keypoints, and where they come from.

#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <Eigen/Core>
#include <Eigen/StdVector>

#include "src/dense/dense_sift.h"

namespace mfir {

// Patches of one image. The centre of feature pixel (column, row) of patch i
// lies at image coordinates (COLMAP's: the centre of the top-left pixel is
// (0.5, 0.5))
//   x = (corners[i].x() + column + 0.5) * pixel_size,
//   y = (corners[i].y() + row + 0.5) * pixel_size.
struct DenseFeaturePatches {
  int patch_size = 0;  // feature pixels along each side
  int num_channels = 0;
  // Image pixels per feature pixel: the stride of the descriptor map.
  double pixel_size = 1.0;
  // One element per keypoint asked for, in its order.
  std::vector<Eigen::Vector2i> corners;
  // False where the keypoint has no feature (outside of the image, say).
  std::vector<bool> valid;
  // IEEE half precision: element [((i * patch_size + row) * patch_size +
  // column) * num_channels + channel], zero where not valid.
  std::vector<uint16_t> data;

  size_t PatchNumElements() const {
    return static_cast<size_t>(patch_size) * patch_size * num_channels;
  }
};

// Image coordinates. With Eigen's allocator, since COLMAP specializes
// std::vector of the bare type: without, code that includes COLMAP's headers
// and code that does not would disagree on what it is.
using Keypoints =
    std::vector<Eigen::Vector2d, Eigen::aligned_allocator<Eigen::Vector2d>>;

// An image whose features are asked for.
struct DenseFeatureRequest {
  std::string frame_name;
  std::string camera_name;
  // Name of the image in the model of its frame.
  std::string image_name;
  // Its size in that model; an image file of another size is an error.
  int width = 0;
  int height = 0;
  // Image coordinates and ids (indices into the image's 2D points).
  Keypoints keypoints;
  std::vector<uint32_t> keypoint_ids;
};

// Throws InputError for an image or database that cannot be read.
class DenseFeatureSource {
 public:
  virtual ~DenseFeatureSource() = default;

  // All patches of a source have the same size and number of channels, except
  // that an image without any valid patch may have zero of both.
  virtual DenseFeaturePatches Extract(const DenseFeatureRequest& request) = 0;

  // For who computes dense SIFT itself: true if these are the source's
  // features, with the image, and where its patches lie (without their data;
  // none are valid if there is no image).
  virtual bool ReadSiftImage(const DenseFeatureRequest&,
                             SiftImage*,
                             DenseFeaturePatches*) {
    return false;
  }

  // Whether to ask again for an image is better than to keep its patches.
  virtual bool RepeatsCheaply() const { return false; }

  // To be called after the last Extract: completes what the source writes.
  // Throws OutputError.
  virtual void Finish() {}
};

// Patches of `patch_size` with the keypoint within half a feature pixel of
// their centre, moved inside where they would leave the image. All data are
// zero. Not valid: keypoints that are not finite or outside of the image.
// Throws InputError for an image smaller than a patch.
DenseFeaturePatches PlacePatches(const DenseFeatureRequest& request,
                                 int patch_size,
                                 int num_channels,
                                 double pixel_size);

// The same without the data.
DenseFeaturePatches PlaceEmptyPatches(const DenseFeatureRequest& request,
                                      int patch_size,
                                      int num_channels,
                                      double pixel_size);

// An image without any feature.
DenseFeaturePatches NoPatches(const DenseFeatureRequest& request);

// As patches store them: rounded to nearest, not finite beyond the range.
void FloatsToHalves(const float* values, int num_values, uint16_t* halves);

// Copies a descriptor to feature pixel (column, row) of patch i.
void SetDescriptor(const float* descriptor,
                   size_t i,
                   int column,
                   int row,
                   DenseFeaturePatches* patches);

// Makes patches with values that are not finite not valid.
void InvalidateNonFinite(DenseFeaturePatches* patches);

}  // namespace mfir
