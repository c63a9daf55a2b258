#include "colmap_ext/feature/sift_feature_source.h"

#include <algorithm>
#include <map>
#include <memory>

#include "colmap_ext/host/dense_sift.h"
#include "colmap_ext/host/image_file.h"
#include "src/dense/dense_sift_kernels.h"
#include "src/parallel/parallel_for.h"

namespace mfir {
namespace {

// Side of the cells whose patches are computed together where they overlap.
constexpr int kCellSize = 32;

SiftImage SmoothedImage(const host::Bitmap& bitmap,
                        const SiftFeatureOptions& options) {
  const std::vector<uint8_t> pixels = host::RowMajorData(bitmap);
  SiftImage image{bitmap.Width(), bitmap.Height(), options.bin_size, {}};
  image.grey.assign(pixels.begin(), pixels.end());
  if (options.smoothing > 0.0) {
    const std::vector<float> original = image.grey;
    vl_imsmooth_f(image.grey.data(),
                  image.width,
                  original.data(),
                  image.width,
                  image.height,
                  image.width,
                  options.smoothing,
                  options.smoothing);
  }
  return image;
}

// Pixels [x, x + width) x [y, y + height) and the patches in them.
struct Region {
  int x;
  int y;
  int width;
  int height;
  std::vector<size_t> patches;

  int Area() const { return width * height; }
};

Region BoundingRegion(const DenseFeaturePatches& patches,
                      const std::vector<size_t>& indices) {
  Eigen::Vector2i min = patches.corners[indices.front()];
  Eigen::Vector2i max = min;
  for (const size_t i : indices) {
    min = min.cwiseMin(patches.corners[i]);
    max = max.cwiseMax(patches.corners[i]);
  }
  const Eigen::Vector2i size =
      max - min + Eigen::Vector2i::Constant(patches.patch_size);
  return {min.x(), min.y(), size.x(), size.y(), indices};
}

// Neighbouring patches in one region where that has fewer pixels than they
// have together, the others in regions of their own.
std::vector<Region> GroupPatches(const DenseFeaturePatches& patches) {
  std::map<std::pair<int, int>, std::vector<size_t>> cells;
  for (size_t i = 0; i < patches.corners.size(); ++i) {
    if (!patches.valid[i]) continue;
    const Eigen::Vector2i cell = patches.corners[i] / kCellSize;
    cells[{cell.y(), cell.x()}].push_back(i);
  }
  std::vector<Region> regions;
  for (const auto& cell_and_indices : cells) {
    const std::vector<size_t>& indices = cell_and_indices.second;
    Region merged = BoundingRegion(patches, indices);
    std::vector<Region> single;
    int single_area = 0;
    for (const size_t i : indices) {
      single.push_back(BoundingRegion(patches, {i}));
      single_area += single.back().Area();
    }
    if (merged.Area() <= single_area) {
      regions.push_back(std::move(merged));
    } else {
      regions.insert(regions.end(), single.begin(), single.end());
    }
  }
  return regions;
}

// The region and `margin` pixels around it, border pixels repeated.
std::vector<float> CutOut(const SiftImage& image,
                          const Region& region,
                          int margin) {
  std::vector<float> window;
  window.reserve(static_cast<size_t>(region.width + 2 * margin) *
                 (region.height + 2 * margin));
  for (int y = region.y - margin; y < region.y + region.height + margin; ++y) {
    const float* row =
        &image.grey[static_cast<size_t>(std::clamp(y, 0, image.height - 1)) *
                    image.width];
    for (int x = region.x - margin; x < region.x + region.width + margin; ++x) {
      window.push_back(row[std::clamp(x, 0, image.width - 1)]);
    }
  }
  return window;
}

using FilterPtr = std::unique_ptr<VlDsiftFilter, decltype(&vl_dsift_delete)>;

// A filter after the computation of the descriptors at the pixels of `region`.
FilterPtr ComputeDescriptors(const SiftImage& image, const Region& region) {
  const int bin_size = image.bin_size;
  // The centres of the bins lie up to 1.5 bins from the pixel; each bin reaches
  // one bin further, and the gradients one pixel.
  const int radius = (kNumSiftBins - 1) * bin_size / 2;
  const int margin = radius + bin_size + 1;
  const std::vector<float> window = CutOut(image, region, margin);
  FilterPtr filter(
      vl_dsift_new_basic(
          region.width + 2 * margin, region.height + 2 * margin, 1, bin_size),
      &vl_dsift_delete);
  vl_dsift_set_flat_window(filter.get(), true);
  // The first descriptor is centred `radius` after the first bound.
  vl_dsift_set_bounds(filter.get(),
                      margin - radius,
                      margin - radius,
                      margin + region.width - 1 + radius,
                      margin + region.height - 1 + radius);
  vl_dsift_process(filter.get(), window.data());
  return filter;
}

// The square root of the L1-normalized descriptor. VLFeat's running sums leave
// rounding errors of either sign.
void RootNormalize(const float* descriptor, float* root) {
  using Array = Eigen::Array<float, kNumSiftChannels, 1>;
  const Array positive = Eigen::Map<const Array>(descriptor).max(0.0f);
  Eigen::Map<Array>{root} = (positive / positive.sum()).sqrt();
}

void FillPatches(const VlDsiftFilter& filter,
                 const Region& region,
                 DenseFeaturePatches* patches) {
  const float* descriptors = vl_dsift_get_descriptors(&filter);
  const VlDsiftKeypoint* keypoints = vl_dsift_get_keypoints(&filter);
  std::vector<uint16_t> halves(
      static_cast<size_t>(region.Area()) * kNumSiftChannels, 0);
  float root[kNumSiftChannels];
  for (int i = 0; i < region.Area(); ++i) {
    if (keypoints[i].norm > kMinSiftGradient) {
      const size_t offset = static_cast<size_t>(i) * kNumSiftChannels;
      RootNormalize(descriptors + offset, root);
      FloatsToHalves(root, kNumSiftChannels, &halves[offset]);
    }
  }
  const size_t row_size =
      static_cast<size_t>(patches->patch_size) * kNumSiftChannels;
  for (const size_t i : region.patches) {
    const Eigen::Vector2i corner =
        patches->corners[i] - Eigen::Vector2i(region.x, region.y);
    uint16_t* patch = &patches->data[i * patches->PatchNumElements()];
    for (int row = 0; row < patches->patch_size; ++row) {
      const size_t pixel =
          static_cast<size_t>(corner.y() + row) * region.width + corner.x();
      std::copy_n(
          &halves[pixel * kNumSiftChannels], row_size, patch + row * row_size);
    }
  }
}

}  // namespace

SiftFeatureSource::SiftFeatureSource(const SiftFeatureOptions& options,
                                     int patch_size,
                                     int num_threads,
                                     const std::string& image_path)
    : options_(options),
      patch_size_(patch_size),
      num_threads_(num_threads),
      images_(image_path) {}

DenseFeaturePatches SiftFeatureSource::Extract(
    const DenseFeatureRequest& request) {
  SiftImage image;
  DenseFeaturePatches patches;
  ReadSiftImage(request, &image, &patches);
  patches.data.resize(patches.valid.size() * patches.PatchNumElements(), 0);
  const std::vector<Region> regions = GroupPatches(patches);
  ParallelFor(regions.size(), num_threads_, [&](size_t i) {
    const FilterPtr filter = ComputeDescriptors(image, regions[i]);
    FillPatches(*filter, regions[i], &patches);
  });
  return patches;
}

bool SiftFeatureSource::ReadSiftImage(const DenseFeatureRequest& request,
                                      SiftImage* image,
                                      DenseFeaturePatches* patches) {
  host::Bitmap bitmap;
  if (!images_.Read(request, /*as_rgb=*/false, &bitmap)) {
    *patches = NoPatches(request);
    return true;
  }
  *image = SmoothedImage(bitmap, options_);
  *patches = PlaceEmptyPatches(request, patch_size_, kNumSiftChannels, 1.0);
  return true;
}

}  // namespace mfir
