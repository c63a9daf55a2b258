// Reference features and cost maps: the same functions are called by the loops
// on the CPU (cost_maps.cc) and by the CUDA kernels (cuda/cost_maps_gpu.cu).
//
// A group of threads (thread_group.h) works on one track or patch: the
// reference features need Rank, Size and Sum, the cost maps all but Sum. On the
// CPU it is a single thread, and all loops over channels vectorize. Features
// are fp16, rows of `num_channels` elements, patches as in DenseFeaturePatches.

#pragma once

#include <cfloat>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "src/geometry/cubic_interpolation.h"
#include "src/parallel/thread_group.h"
#include "src/util/half_float.h"

namespace mfir {

// -----------------------------------------------------------------------------
// Reference feature of a track
// -----------------------------------------------------------------------------

constexpr int kMaxNumRobustMeanIterations = 50;
constexpr float kRobustMeanTolerance = 1e-5f;  // of the loss scale

template <typename Group>
MFIR_HOST_DEVICE float SquaredDistance(const Group& group,
                                       const uint16_t* feature,
                                       const float* mean,
                                       int num_channels) {
  float sum = 0.0f;
  for (int c = group.Rank(); c < num_channels; c += Group::Size()) {
    const float difference = HalfToFloat(feature[c]) - mean[c];
    sum += difference * difference;
  }
  return group.Sum(sum);
}

// One step of iterative reweighting: replaces `mean` by the mean with the
// weights 1 / (1 + |f - mean|^2 * inverse_squared_scale). Returns the squared
// length of the step, or -1 without any finite feature; *mean_squared is the
// (unweighted) mean of |f - mean|^2. Features that are not finite take no part.
template <typename Group>
MFIR_HOST_DEVICE float ReweightedMean(const Group& group,
                                      const uint16_t* features,
                                      int64_t num_features,
                                      int num_channels,
                                      float inverse_squared_scale,
                                      float* mean,
                                      float* sums,
                                      float* mean_squared) {
  for (int c = group.Rank(); c < num_channels; c += Group::Size()) {
    sums[c] = 0.0f;
  }
  float weight_sum = 0.0f;
  float squared_sum = 0.0f;
  int64_t count = 0;
  for (int64_t i = 0; i < num_features; ++i) {
    const uint16_t* feature = features + i * num_channels;
    const float squared = SquaredDistance(group, feature, mean, num_channels);
    if (!(squared <= FLT_MAX)) continue;
    const float weight = 1.0f / (1.0f + squared * inverse_squared_scale);
    for (int c = group.Rank(); c < num_channels; c += Group::Size()) {
      sums[c] += weight * HalfToFloat(feature[c]);
    }
    weight_sum += weight;
    squared_sum += squared;
    ++count;
  }
  if (count == 0) return -1.0f;
  *mean_squared = squared_sum / static_cast<float>(count);
  float squared_step = 0.0f;
  for (int c = group.Rank(); c < num_channels; c += Group::Size()) {
    const float new_mean = sums[c] / weight_sum;
    squared_step += (new_mean - mean[c]) * (new_mean - mean[c]);
    mean[c] = new_mean;
  }
  return group.Sum(squared_step);
}

// Index of the track's feature (eq. "reference feature" of the paper): the one
// nearest to the robust mean of all, which minimizes the sum of the Cauchy loss
// of |f - mean|; -1 if none is finite. `loss_scale` is relative to the
// root mean square of |f| (which is 1 for the usual normalized features), so
// that the unit of the features does not matter. `scratch`: 2 * num_channels.
template <typename Group>
MFIR_HOST_DEVICE int64_t FindReferenceFeature(const Group& group,
                                              const uint16_t* features,
                                              int64_t num_features,
                                              int num_channels,
                                              float loss_scale,
                                              float* scratch) {
  // Each thread reads and writes only its own channels of these.
  float* mean = scratch;
  float* sums = scratch + num_channels;
  for (int c = group.Rank(); c < num_channels; c += Group::Size()) {
    mean[c] = 0.0f;
  }
  float mean_squared = 0.0f;
  const float first_step = ReweightedMean(group,
                                          features,
                                          num_features,
                                          num_channels,
                                          0.0f,
                                          mean,
                                          sums,
                                          &mean_squared);
  if (first_step < 0.0f) return -1;
  const float squared_scale =
      fmaxf(loss_scale * loss_scale * mean_squared, FLT_MIN);
  const float tolerance =
      kRobustMeanTolerance * kRobustMeanTolerance * squared_scale;
  for (int i = 0; i < kMaxNumRobustMeanIterations; ++i) {
    const float step = ReweightedMean(group,
                                      features,
                                      num_features,
                                      num_channels,
                                      1.0f / squared_scale,
                                      mean,
                                      sums,
                                      &mean_squared);
    if (!(step > tolerance)) break;
  }
  int64_t nearest = -1;
  float min_squared = FLT_MAX;
  for (int64_t i = 0; i < num_features; ++i) {
    const float squared =
        SquaredDistance(group, features + i * num_channels, mean, num_channels);
    if (squared < min_squared) {
      min_squared = squared;
      nearest = i;
    }
  }
  return nearest;
}

// -----------------------------------------------------------------------------
// Cost map of a patch
// -----------------------------------------------------------------------------

constexpr int kNumCostChannels = 3;
constexpr int kMinPatchSize = kMinCubicSize;
// What a CUDA block holds in its shared memory.
constexpr int kMaxPatchSize = 24;

struct PatchShape {
  int patch_size;  // feature pixels along each side
  int num_channels;

  MFIR_HOST_DEVICE int NumPixels() const { return patch_size * patch_size; }
  MFIR_HOST_DEVICE size_t NumElements() const {
    return static_cast<size_t>(NumPixels()) * num_channels;
  }
  MFIR_HOST_DEVICE size_t NumCostElements() const {
    return static_cast<size_t>(NumPixels()) * kNumCostChannels;
  }
};

// Scalar products of the difference d = F - f of a pixel with its own, and with
// those of the pixels one and two to the right and below. All derivatives of
// |d| follow from them: f cancels in the differences of F. Those at a distance
// of two are needed, and set, at the border only.
struct PixelProducts {
  float own;
  float right;
  float below;
  float right2;
  float below2;
};

// Floats that the threads of a group share.
MFIR_HOST_DEVICE int DifferencesSize(const PatchShape& shape,
                                     int chunk,
                                     int pitch) {
  return shape.NumPixels() * pitch + chunk;
}

// Adds the products of `chunk` channels of a pixel.
MFIR_HOST_DEVICE void AddPixelProducts(const float* differences,
                                       int pixel,
                                       int patch_size,
                                       int chunk,
                                       int pitch,
                                       PixelProducts* products) {
  const int row = pixel / patch_size;
  const int column = pixel % patch_size;
  const float* own = differences + pixel * pitch;
  // Without a neighbour the product is not used.
  const int right = column + 1 < patch_size ? pitch : 0;
  const int below = row + 1 < patch_size ? patch_size * pitch : 0;
  float own_sum = 0.0f;
  float right_sum = 0.0f;
  float below_sum = 0.0f;
  for (int c = 0; c < chunk; ++c) {
    own_sum += own[c] * own[c];
    right_sum += own[c] * own[right + c];
    below_sum += own[c] * own[below + c];
  }
  products->own += own_sum;
  products->right += right_sum;
  products->below += below_sum;
  if (column == 0 || column == patch_size - 3) {
    float sum = 0.0f;
    for (int c = 0; c < chunk; ++c) sum += own[c] * own[2 * pitch + c];
    products->right2 += sum;
  }
  if (row == 0 || row == patch_size - 3) {
    const int below2 = 2 * patch_size * pitch;
    float sum = 0.0f;
    for (int c = 0; c < chunk; ++c) sum += own[c] * own[below2 + c];
    products->below2 += sum;
  }
}

// d . F_u of a pixel, per feature pixel, where F_u is the derivative at the
// node of the spline of cubic_interpolation.h: the central difference, at the
// border its one-sided form of the same order. `i`: the pixel along the
// direction of u, `stride`: from one to the next; `next`, `next2`: the products
// in that direction.
MFIR_HOST_DEVICE float GradientProduct(const PixelProducts* pixel,
                                       int i,
                                       int patch_size,
                                       int stride,
                                       float PixelProducts::*next,
                                       float PixelProducts::*next2) {
  if (i == 0) {
    return 0.5f * (4.0f * (pixel->*next) - 3.0f * pixel->own - (pixel->*next2));
  }
  const float previous = (pixel - stride)->*next;
  if (i == patch_size - 1) {
    return 0.5f *
           (3.0f * pixel->own - 4.0f * previous + (pixel - 2 * stride)->*next2);
  }
  return 0.5f * ((pixel->*next) - previous);
}

// Distance |F - f| and its derivatives by the image coordinates: zero where the
// distance is, NaN where the features are not finite.
MFIR_HOST_DEVICE void WriteCostPixel(const PixelProducts* products,
                                     int pixel,
                                     int patch_size,
                                     float inverse_pixel_size,
                                     uint16_t* cost) {
  const PixelProducts* own = products + pixel;
  const float distance =
      own->own <= FLT_MAX ? sqrtf(own->own) : BitsToFloat(0x7fc00000u);
  const float factor = distance == 0.0f ? 0.0f : inverse_pixel_size / distance;
  cost[0] = FloatToClampedHalf(distance);
  cost[1] =
      FloatToClampedHalf(factor * GradientProduct(own,
                                                  pixel % patch_size,
                                                  patch_size,
                                                  1,
                                                  &PixelProducts::right,
                                                  &PixelProducts::right2));
  cost[2] =
      FloatToClampedHalf(factor * GradientProduct(own,
                                                  pixel / patch_size,
                                                  patch_size,
                                                  patch_size,
                                                  &PixelProducts::below,
                                                  &PixelProducts::below2));
}

// Cost map (eq. "cost map" of the paper) of one patch: element
// [(row * patch_size + column) * 3 + k] of `cost_map` is, for k = 0, 1, 2, the
// distance of the feature from `reference` and its derivatives by the image's x
// and y. `inverse_pixel_size`: feature pixels per image pixel. Shared by the
// group: `differences` (DifferencesSize()) and `products` (one per pixel);
// channels are taken `chunk` at a time, their differences rows of `pitch`.
template <typename Group>
MFIR_HOST_DEVICE void ComputeCostMap(const Group& group,
                                     const PatchShape& shape,
                                     float inverse_pixel_size,
                                     const uint16_t* patch,
                                     const uint16_t* reference,
                                     int chunk,
                                     int pitch,
                                     float* differences,
                                     PixelProducts* products,
                                     uint16_t* cost_map) {
  const int num_pixels = shape.NumPixels();
  float* chunk_reference = differences + num_pixels * pitch;
  for (int i = group.Rank(); i < num_pixels; i += Group::Size()) {
    products[i] = {0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
  }
  for (int begin = 0; begin < shape.num_channels; begin += chunk) {
    const int size =
        chunk < shape.num_channels - begin ? chunk : shape.num_channels - begin;
    group.Sync();
    for (int c = group.Rank(); c < size; c += Group::Size()) {
      chunk_reference[c] = HalfToFloat(reference[begin + c]);
    }
    group.Sync();
    for (int i = group.Row(); i < num_pixels; i += Group::NumRows()) {
      const uint16_t* feature =
          patch + static_cast<size_t>(i) * shape.num_channels + begin;
      float* difference = differences + i * pitch;
      for (int c = group.Column(); c < size; c += Group::NumColumns()) {
        difference[c] = HalfToFloat(feature[c]) - chunk_reference[c];
      }
    }
    group.Sync();
    for (int i = group.Rank(); i < num_pixels; i += Group::Size()) {
      AddPixelProducts(
          differences, i, shape.patch_size, size, pitch, &products[i]);
    }
  }
  group.Sync();
  for (int i = group.Rank(); i < num_pixels; i += Group::Size()) {
    WriteCostPixel(products,
                   i,
                   shape.patch_size,
                   inverse_pixel_size,
                   cost_map + i * kNumCostChannels);
  }
  // Nobody overwrites what others still read.
  group.Sync();
}

// -----------------------------------------------------------------------------
// Grids of groups: group `first` of `stride` groups works on every stride-th
// item, so that a grid of any size covers any number of items.
// -----------------------------------------------------------------------------

// Tracks i = features track_begins[i] ... track_begins[i + 1] - 1; the index of
// its reference feature within all, or -1, goes to references[i].
template <typename Group>
MFIR_HOST_DEVICE void FindReferenceFeatures(const Group& group,
                                            int64_t first,
                                            int64_t stride,
                                            const uint16_t* features,
                                            const int64_t* track_begins,
                                            int64_t num_tracks,
                                            int num_channels,
                                            float loss_scale,
                                            float* scratch,
                                            int64_t* references) {
  for (int64_t i = first; i < num_tracks; i += stride) {
    const int64_t begin = track_begins[i];
    const int64_t reference =
        FindReferenceFeature(group,
                             features + begin * num_channels,
                             track_begins[i + 1] - begin,
                             num_channels,
                             loss_scale,
                             scratch);
    if (group.Rank() == 0) {
      references[i] = reference < 0 ? -1 : begin + reference;
    }
  }
}

// Patch i with the reference feature in row i.
template <typename Group>
MFIR_HOST_DEVICE void ComputeCostMaps(const Group& group,
                                      int64_t first,
                                      int64_t stride,
                                      const PatchShape& shape,
                                      float inverse_pixel_size,
                                      const uint16_t* patches,
                                      const uint16_t* references,
                                      int64_t num_patches,
                                      int chunk,
                                      int pitch,
                                      float* differences,
                                      PixelProducts* products,
                                      uint16_t* cost_maps) {
  for (int64_t i = first; i < num_patches; i += stride) {
    const size_t idx = static_cast<size_t>(i);
    ComputeCostMap(group,
                   shape,
                   inverse_pixel_size,
                   patches + idx * shape.NumElements(),
                   references + idx * shape.num_channels,
                   chunk,
                   pitch,
                   differences,
                   products,
                   cost_maps + idx * shape.NumCostElements());
  }
}

}  // namespace mfir
