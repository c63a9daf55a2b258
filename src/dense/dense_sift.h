// Dense SIFT that is computed where the cost maps are.

#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace mfir {

// An image, smoothed already, whose features are dense SIFT descriptors.
struct SiftImage {
  int width = 0;
  int height = 0;
  int bin_size = 0;         // px, even
  std::vector<float> grey;  // row-major, 0 to 255
};

// First pixel of a patch, which lies inside the image.
struct SiftCorner {
  int x;
  int y;
};

// The 4 x 4 pixels around a keypoint and their weights.
struct DenseSiftKeypoint {
  SiftCorner corner;
  float row_weights[4];
  float column_weights[4];
};

// Cost map of the patch with this corner, see CostMapJob.
struct SiftMapJob {
  SiftCorner corner;
  const uint16_t* reference;
  uint16_t* cost_map;
};

// Features and cost maps of one image, which is in the memory of a GPU. Not to
// be used after its backend, but it may outlive that.
class DeviceSift {
 public:
  virtual ~DeviceSift() = default;

  // Of the memory that it holds there.
  virtual size_t NumBytes() const = 0;

  // Features at keypoints: rows of fp16.
  virtual void Interpolate(const std::vector<DenseSiftKeypoint>& keypoints,
                           uint16_t* features) = 0;

  virtual void ComputeMaps(int patch_size,
                           const std::vector<SiftMapJob>& jobs) = 0;
};

}  // namespace mfir
