#include "src/patches/spline_image.h"

#include <algorithm>
#include <utility>

namespace mfir {
namespace {

// Of the recursive filter that turns samples into coefficients.
constexpr float kPole = -0.26794919243112270f;  // sqrt(3) - 2
// The filter's memory: its pole to this power is below float precision.
constexpr size_t kHorizon = 14;
constexpr float kFilterGain = 6.0f;  // (1 - pole) (1 - 1 / pole)

// Rows of `width` numbers, `height` of them; the filter runs over the rows, for
// all columns at once.
void FilterDown(size_t width, size_t height, float* data) {
  const auto row = [&](size_t y) { return data + y * width; };
  // What the causal filter has at row 0 if the rows go on mirrored.
  std::vector<float> start(width, 0.0f);
  const size_t period = height > 1 ? 2 * (height - 1) : 1;
  float power = 1.0f;
  for (size_t k = 0; k < kHorizon; ++k) {
    const size_t y = k % period < height ? k % period : period - k % period;
    for (size_t x = 0; x < width; ++x) start[x] += power * row(y)[x];
    power *= kPole;
  }
  std::copy(start.begin(), start.end(), row(0));
  for (size_t y = 1; y < height; ++y) {
    for (size_t x = 0; x < width; ++x) row(y)[x] += kPole * row(y - 1)[x];
  }
  const float factor = kFilterGain * kPole / (kPole * kPole - 1.0f);
  float* last = row(height - 1);
  const float* previous = height > 1 ? row(height - 2) : last;
  for (size_t x = 0; x < width; ++x) {
    last[x] = factor * (last[x] + kPole * previous[x]);
  }
  for (size_t y = height - 1; y-- > 0;) {
    for (size_t x = 0; x < width; ++x) {
      row(y)[x] = kPole * (row(y + 1)[x] - kFilterGain * row(y)[x]);
    }
  }
}

std::vector<float> Transposed(size_t width,
                              size_t height,
                              const std::vector<float>& data) {
  constexpr size_t kBlock = 16;
  std::vector<float> result(data.size());
  for (size_t top = 0; top < height; top += kBlock) {
    for (size_t left = 0; left < width; left += kBlock) {
      for (size_t y = top; y < std::min(top + kBlock, height); ++y) {
        for (size_t x = left; x < std::min(left + kBlock, width); ++x) {
          result[x * height + y] = data[y * width + x];
        }
      }
    }
  }
  return result;
}

}  // namespace

SplineImage::SplineImage(size_t width, size_t height, std::vector<float> pixels)
    : width_(width), height_(height), coefficients_(std::move(pixels)) {
  FilterDown(width, height, coefficients_.data());
  coefficients_ = Transposed(width, height, coefficients_);
  FilterDown(height, width, coefficients_.data());
  coefficients_ = Transposed(height, width, coefficients_);
}

}  // namespace mfir
