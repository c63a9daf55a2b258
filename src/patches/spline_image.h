// Images that are sampled between their pixels.

#pragma once

#include <cstddef>
#include <vector>

#include "src/patches/patch_alignment_kernels.h"

namespace mfir {

// A grey image as a cubic B-spline through its pixels, mirrored at its borders.
class SplineImage {
 public:
  // No image.
  SplineImage() = default;
  // `pixels`: rows of `width`, grey levels; at least one.
  SplineImage(size_t width, size_t height, std::vector<float> pixels);

  bool Empty() const { return coefficients_.empty(); }
  SplineView View() const {
    return {coefficients_.data(),
            static_cast<int>(width_),
            static_cast<int>(height_)};
  }

 private:
  size_t width_ = 0;
  size_t height_ = 0;
  std::vector<float> coefficients_;
};

}  // namespace mfir
