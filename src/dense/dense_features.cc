#include "src/dense/dense_features.h"

#include <algorithm>
#include <cmath>

#include "src/util/errors.h"
#include "src/util/half_float.h"
#include "src/util/target_clones.h"

namespace mfir {
namespace {

// First of `patch_size` feature pixels around the coordinate `center` (in
// feature pixels) on a map of `map_size`.
int PlaceAlongAxis(double center, int patch_size, int map_size) {
  const double first = std::floor(center - 0.5 * patch_size + 0.5);
  return static_cast<int>(
      std::clamp<double>(first, 0.0, map_size - patch_size));
}

}  // namespace

DenseFeaturePatches PlacePatches(const DenseFeatureRequest& request,
                                 int patch_size,
                                 int num_channels,
                                 double pixel_size) {
  DenseFeaturePatches patches =
      PlaceEmptyPatches(request, patch_size, num_channels, pixel_size);
  patches.data.resize(patches.valid.size() * patches.PatchNumElements(), 0);
  return patches;
}

DenseFeaturePatches PlaceEmptyPatches(const DenseFeatureRequest& request,
                                      int patch_size,
                                      int num_channels,
                                      double pixel_size) {
  const int map_width = static_cast<int>(request.width / pixel_size);
  const int map_height = static_cast<int>(request.height / pixel_size);
  if (map_width < patch_size || map_height < patch_size) {
    throw InputError("Image '" + request.image_name + "' of frame '" +
                     request.frame_name + "' has " + std::to_string(map_width) +
                     " x " + std::to_string(map_height) +
                     " feature pixels, less than a patch. Lower "
                     "--MultiFrame.feature_patch_size.");
  }
  DenseFeaturePatches patches = NoPatches(request);
  patches.patch_size = patch_size;
  patches.num_channels = num_channels;
  patches.pixel_size = pixel_size;
  for (size_t i = 0; i < request.keypoints.size(); ++i) {
    const Eigen::Vector2d& keypoint = request.keypoints[i];
    // False for NaN as well.
    if (!(keypoint.x() >= 0.0 && keypoint.x() <= request.width &&
          keypoint.y() >= 0.0 && keypoint.y() <= request.height)) {
      continue;
    }
    patches.valid[i] = true;
    patches.corners[i] = Eigen::Vector2i(
        PlaceAlongAxis(keypoint.x() / pixel_size, patch_size, map_width),
        PlaceAlongAxis(keypoint.y() / pixel_size, patch_size, map_height));
  }
  return patches;
}

DenseFeaturePatches NoPatches(const DenseFeatureRequest& request) {
  DenseFeaturePatches patches;
  patches.corners.resize(request.keypoints.size(), Eigen::Vector2i::Zero());
  patches.valid.resize(request.keypoints.size(), false);
  return patches;
}

MFIR_TARGET_CLONES
void FloatsToHalves(const float* values, int num_values, uint16_t* halves) {
  for (int i = 0; i < num_values; ++i) halves[i] = FloatToHalf(values[i]);
}

void SetDescriptor(const float* descriptor,
                   size_t i,
                   int column,
                   int row,
                   DenseFeaturePatches* patches) {
  const size_t pixel =
      (i * patches->patch_size + row) * patches->patch_size + column;
  uint16_t* data = &patches->data[pixel * patches->num_channels];
  FloatsToHalves(descriptor, patches->num_channels, data);
}

void InvalidateNonFinite(DenseFeaturePatches* patches) {
  constexpr uint16_t kExponent = 0x7C00;  // All ones: infinite or NaN.
  const size_t size = patches->PatchNumElements();
  for (size_t i = 0; i < patches->valid.size(); ++i) {
    const auto begin = patches->data.begin() + i * size;
    if (std::any_of(begin, begin + size, [](uint16_t half) {
          return (half & kExponent) == kExponent;
        })) {
      patches->valid[i] = false;
      std::fill(begin, begin + size, 0);
    }
  }
}

}  // namespace mfir
