// Dense SIFT descriptors: the functions of the CUDA kernels
// (cuda/dense_sift_gpu.cu), which the tests run on the CPU.
//
// They compute what SiftFeatureSource does with VLFeat's dense SIFT (flat
// window): the square roots of L1-normalized upright descriptors. A CPU is
// faster with VLFeat's running sums, a GPU with sums of their own for each
// pixel. Steps, of which each is a grid of threads or groups:
//   1. the gradient at each pixel,
//   2. its magnitudes by orientation, summed along rows with the weights of a
//      bin (a triangle, two bins wide),
//   3. the same along columns: the value of a bin centred at each pixel,
//   4. the descriptors, which take their 4 x 4 bins from there.
// Beyond the image's border its border pixels are repeated.

#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>

#include "src/dense/dense_sift.h"
#include "src/util/half_float.h"

namespace mfir {

constexpr int kNumSiftOrientations = 8;
constexpr int kNumSiftBins = 4;  // along each axis
constexpr int kNumSiftChannels =
    kNumSiftBins * kNumSiftBins * kNumSiftOrientations;
// Weighted mean of the gradients (grey levels per px) below which a descriptor
// would be rounding errors scaled to unit length.
constexpr float kMinSiftGradient = 0.01f;

// -----------------------------------------------------------------------------
// Geometry
// -----------------------------------------------------------------------------

// Pixels [x, x + width) x [y, y + height), row-major.
struct SiftRange {
  int x;
  int y;
  int width;
  int height;

  MFIR_HOST_DEVICE int64_t NumPixels() const {
    return static_cast<int64_t>(width) * height;
  }
  MFIR_HOST_DEVICE int64_t Index(int pixel_x, int pixel_y) const {
    return static_cast<int64_t>(pixel_y - y) * width + (pixel_x - x);
  }
};

struct SiftLayout {
  int width;
  int height;
  int bin_size;  // even
  // By bin along an axis: mean of the Gaussian window.
  float bin_weights[kNumSiftBins];

  // The image and so much around it.
  MFIR_HOST_DEVICE SiftRange Extended(int columns, int rows) const {
    return {-columns, -rows, width + 2 * columns, height + 2 * rows};
  }
  // From a pixel to the centres of its outer bins, and to their last pixels.
  MFIR_HOST_DEVICE int Radius() const {
    return (kNumSiftBins - 1) * bin_size / 2;
  }
  MFIR_HOST_DEVICE int Reach() const { return Radius() + bin_size - 1; }

  // Where the results of steps 1, 2 and 3 are needed.
  MFIR_HOST_DEVICE SiftRange Gradients() const {
    return Extended(Reach(), Reach());
  }
  MFIR_HOST_DEVICE SiftRange RowSums() const {
    return Extended(Radius(), Reach());
  }
  MFIR_HOST_DEVICE SiftRange Bins() const {
    return Extended(Radius(), Radius());
  }
};

inline SiftLayout MakeSiftLayout(int width, int height, int bin_size) {
  SiftLayout layout{width, height, bin_size, {}};
  const float sigma = 2.0f * static_cast<float>(bin_size);
  for (int bin = 0; bin < kNumSiftBins; ++bin) {
    const float center = static_cast<float>(bin_size) *
                         (static_cast<float>(bin) - 0.5f * (kNumSiftBins - 1));
    float sum = 0.0f;
    for (int x = 1 - bin_size; x < bin_size; ++x) {
      const float z = (static_cast<float>(x) - center) / sigma;
      sum += std::exp(-0.5f * z * z);
    }
    layout.bin_weights[bin] = sum / static_cast<float>(2 * bin_size - 1);
  }
  return layout;
}

// -----------------------------------------------------------------------------
// Steps 1 to 3: thread `first` of `stride` threads computes every stride-th
// element.
// -----------------------------------------------------------------------------

struct SiftGradient {
  float orientation;  // in bins: 0 to kNumSiftOrientations
  float magnitude;    // grey levels per px
};

// VLFeat's approximation of atan2 (its error is 0.006), so that both have the
// same descriptors.
MFIR_HOST_DEVICE float ApproximateAtan2(float y, float x) {
  constexpr float kQuarterPi = 0.785398163f;
  const float abs_y = fabsf(y) + 1.19209290e-7f;
  const float r =
      x >= 0.0f ? (x - abs_y) / (x + abs_y) : (x + abs_y) / (abs_y - x);
  const float angle = (x >= 0.0f ? kQuarterPi : 3.0f * kQuarterPi) +
                      (0.1821f * r * r - 0.9675f) * r;
  return y < 0.0f ? -angle : angle;
}

MFIR_HOST_DEVICE int ClampIndex(int i, int size) {
  return i < 0 ? 0 : i < size ? i : size - 1;
}

MFIR_HOST_DEVICE SiftGradient ComputeSiftGradient(const SiftLayout& layout,
                                                  const float* grey,
                                                  int x,
                                                  int y) {
  const float* row =
      grey + static_cast<int64_t>(ClampIndex(y, layout.height)) * layout.width;
  const float* above =
      grey +
      static_cast<int64_t>(ClampIndex(y - 1, layout.height)) * layout.width;
  const float* below =
      grey +
      static_cast<int64_t>(ClampIndex(y + 1, layout.height)) * layout.width;
  const int column = ClampIndex(x, layout.width);
  const float dx = 0.5f * (row[ClampIndex(x + 1, layout.width)] -
                           row[ClampIndex(x - 1, layout.width)]);
  const float dy = 0.5f * (below[column] - above[column]);
  constexpr float kBinsPerRadian = kNumSiftOrientations / 6.28318531f;
  const float orientation = ApproximateAtan2(dy, dx) * kBinsPerRadian;
  return {orientation < 0.0f ? orientation + kNumSiftOrientations : orientation,
          sqrtf(dx * dx + dy * dy)};
}

// Step 1: one element per pixel of layout.Gradients().
MFIR_HOST_DEVICE void ComputeSiftGradients(int64_t first,
                                           int64_t stride,
                                           const SiftLayout& layout,
                                           const float* grey,
                                           SiftGradient* gradients) {
  const SiftRange range = layout.Gradients();
  for (int64_t i = first; i < range.NumPixels(); i += stride) {
    const int pixel = static_cast<int>(i);
    gradients[i] = ComputeSiftGradient(layout,
                                       grey,
                                       range.x + pixel % range.width,
                                       range.y + pixel / range.width);
  }
}

// Magnitude that goes to bin `bin` of the orientations, which are a circle:
// each gradient is shared by the two next to it.
MFIR_HOST_DEVICE float OrientedMagnitude(const SiftGradient& gradient,
                                         int bin) {
  const float distance = fabsf(gradient.orientation - static_cast<float>(bin));
  const float share = 1.0f - fminf(distance, kNumSiftOrientations - distance);
  return share > 0.0f ? share * gradient.magnitude : 0.0f;
}

// Weight of a bin at `offset` pixels from its centre, times the bin's size.
MFIR_HOST_DEVICE float BinWeight(const SiftLayout& layout, int offset) {
  return static_cast<float>(layout.bin_size - (offset < 0 ? -offset : offset));
}

// Step 2: elements [pixel of layout.RowSums()][orientation].
MFIR_HOST_DEVICE void ComputeSiftRowSums(int64_t first,
                                         int64_t stride,
                                         const SiftLayout& layout,
                                         const SiftGradient* gradients,
                                         float* row_sums) {
  const SiftRange from = layout.Gradients();
  const SiftRange to = layout.RowSums();
  const int64_t count = to.NumPixels() * kNumSiftOrientations;
  for (int64_t i = first; i < count; i += stride) {
    const int pixel = static_cast<int>(i / kNumSiftOrientations);
    const SiftGradient* center =
        gradients +
        from.Index(to.x + pixel % to.width, to.y + pixel / to.width);
    float sum = 0.0f;
    for (int k = 1 - layout.bin_size; k < layout.bin_size; ++k) {
      sum += BinWeight(layout, k) *
             OrientedMagnitude(center[k],
                               static_cast<int>(i % kNumSiftOrientations));
    }
    row_sums[i] = sum / static_cast<float>(layout.bin_size);
  }
}

// Step 3: elements [pixel of layout.Bins()][orientation].
MFIR_HOST_DEVICE void ComputeSiftBins(int64_t first,
                                      int64_t stride,
                                      const SiftLayout& layout,
                                      const float* row_sums,
                                      float* bins) {
  const SiftRange from = layout.RowSums();
  const SiftRange to = layout.Bins();
  const int64_t count = to.NumPixels() * kNumSiftOrientations;
  const int64_t row_size =
      static_cast<int64_t>(from.width) * kNumSiftOrientations;
  // The ranges have the same columns: rows begin so many elements apart.
  const int64_t offset = (to.y - from.y) * row_size;
  for (int64_t i = first; i < count; i += stride) {
    const float* center = row_sums + i + offset;
    float sum = 0.0f;
    for (int k = 1 - layout.bin_size; k < layout.bin_size; ++k) {
      sum += BinWeight(layout, k) * center[k * row_size];
    }
    bins[i] = sum / static_cast<float>(layout.bin_size);
  }
}

// -----------------------------------------------------------------------------
// Step 4: a group of threads (thread_group.h) works on one descriptor. It needs
// Rank, Size and Sum. Thread i has channels i, i + Size, i + 2 * Size, ...
// -----------------------------------------------------------------------------

template <typename Group>
struct SiftChannels {
  static constexpr int kCount = kNumSiftChannels / Group::Size();
  float values[kCount];
};

// The descriptor of pixel (x, y) of the image: of unit length, or zero.
template <typename Group>
MFIR_HOST_DEVICE SiftChannels<Group> ComputeSiftDescriptor(
    const Group& group,
    const SiftLayout& layout,
    const float* bins,
    int x,
    int y) {
  constexpr int kCount = SiftChannels<Group>::kCount;
  const SiftRange range = layout.Bins();
  const float* corner =
      bins + range.Index(x - layout.Radius(), y - layout.Radius()) *
                 kNumSiftOrientations;
  const int64_t column_step =
      static_cast<int64_t>(layout.bin_size) * kNumSiftOrientations;
  const int64_t row_step = column_step * range.width;
  SiftChannels<Group> channels;
  float sum = 0.0f;
  float squared_sum = 0.0f;
  for (int k = 0; k < kCount; ++k) {
    const int channel = group.Rank() + k * Group::Size();
    const int bin = channel / kNumSiftOrientations;
    const int row = bin / kNumSiftBins;
    const int column = bin % kNumSiftBins;
    const float value = layout.bin_weights[row] * layout.bin_weights[column] *
                        corner[row * row_step + column * column_step +
                               channel % kNumSiftOrientations];
    channels.values[k] = value;
    sum += value;
    squared_sum += value * value;
  }
  const float side =
      static_cast<float>((kNumSiftBins - 1) * layout.bin_size + 1);
  if (!(group.Sum(sum) > kMinSiftGradient * side * side)) {
    for (int k = 0; k < kCount; ++k) channels.values[k] = 0.0f;
    return channels;
  }
  // SIFT's bound on what a single bin may contribute.
  const float max_value = 0.2f * sqrtf(group.Sum(squared_sum));
  float bounded_sum = 0.0f;
  for (int k = 0; k < kCount; ++k) {
    channels.values[k] = fminf(channels.values[k], max_value);
    bounded_sum += channels.values[k];
  }
  bounded_sum = group.Sum(bounded_sum);
  for (int k = 0; k < kCount; ++k) {
    channels.values[k] = sqrtf(channels.values[k] / bounded_sum);
  }
  return channels;
}

// The patch with this corner (elements as in DenseFeaturePatches): group
// `first` of `stride` groups computes every stride-th pixel.
template <typename Group>
MFIR_HOST_DEVICE void ComputeSiftPatch(const Group& group,
                                       int first,
                                       int stride,
                                       const SiftLayout& layout,
                                       const float* bins,
                                       const SiftCorner& corner,
                                       int patch_size,
                                       uint16_t* patch) {
  for (int i = first; i < patch_size * patch_size; i += stride) {
    const SiftChannels<Group> channels =
        ComputeSiftDescriptor(group,
                              layout,
                              bins,
                              corner.x + i % patch_size,
                              corner.y + i / patch_size);
    for (int k = 0; k < SiftChannels<Group>::kCount; ++k) {
      patch[i * kNumSiftChannels + group.Rank() + k * Group::Size()] =
          FloatToHalf(channels.values[k]);
    }
  }
}

// The feature at a keypoint, interpolated between descriptors in half
// precision, as those of patches are.
template <typename Group>
MFIR_HOST_DEVICE void InterpolateSiftFeature(const Group& group,
                                             const SiftLayout& layout,
                                             const float* bins,
                                             const DenseSiftKeypoint& keypoint,
                                             uint16_t* feature) {
  constexpr int kCount = SiftChannels<Group>::kCount;
  float sums[kCount] = {};
  for (int i = 0; i < 16; ++i) {
    const SiftChannels<Group> channels =
        ComputeSiftDescriptor(group,
                              layout,
                              bins,
                              keypoint.corner.x + i % 4,
                              keypoint.corner.y + i / 4);
    const float weight =
        keypoint.row_weights[i / 4] * keypoint.column_weights[i % 4];
    for (int k = 0; k < kCount; ++k) {
      sums[k] += weight * HalfToFloat(FloatToHalf(channels.values[k]));
    }
  }
  for (int k = 0; k < kCount; ++k) {
    feature[group.Rank() + k * Group::Size()] = FloatToClampedHalf(sums[k]);
  }
}

}  // namespace mfir
