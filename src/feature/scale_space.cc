#include "src/feature/scale_space.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace mfir {
namespace {

// Of the image as it comes, pixels.
constexpr double kImageSigma = 0.5;

// One half of the symmetric kernel, from the middle; its sum over both is 1.
std::vector<float> HalfKernel(double sigma) {
  const int radius = std::max(1, static_cast<int>(std::ceil(4.0 * sigma)));
  std::vector<float> kernel;
  double sum = 0.0;
  for (int i = 0; i <= radius; ++i) {
    const double value = std::exp(-0.5 * i * i / (sigma * sigma));
    kernel.push_back(static_cast<float>(value));
    sum += i == 0 ? value : 2.0 * value;
  }
  for (float& value : kernel) value = static_cast<float>(value / sum);
  return kernel;
}

// sum[x] += weight * (a[x] + b[x]), which compilers vectorize.
void AddWeighted(
    const float* a, const float* b, float weight, int count, float* sum) {
  for (int x = 0; x < count; ++x) sum[x] += weight * (a[x] + b[x]);
}

void BlurRow(const std::vector<float>& kernel,
             const float* row,
             int width,
             std::vector<float>* padded,
             float* result) {
  const int radius = static_cast<int>(kernel.size()) - 1;
  padded->resize(width + 2 * radius);
  std::fill_n(padded->begin(), radius, row[0]);
  std::copy_n(row, width, padded->begin() + radius);
  std::fill_n(padded->end() - radius, radius, row[width - 1]);
  const float* middle = padded->data() + radius;
  for (int x = 0; x < width; ++x) result[x] = kernel[0] * middle[x];
  for (int i = 1; i <= radius; ++i) {
    AddWeighted(middle - i, middle + i, kernel[i], width, result);
  }
}

}  // namespace

FloatImage GaussianBlur(const FloatImage& image, double sigma) {
  const std::vector<float> kernel = HalfKernel(sigma);
  const int radius = static_cast<int>(kernel.size()) - 1;
  const int last = image.height - 1;
  FloatImage result(image.width, image.height);
  FloatImage columns_blurred(image.width, 1);
  std::vector<float> padded;
  for (int y = 0; y < image.height; ++y) {
    float* sum = columns_blurred.Row(0);
    const float* middle = image.Row(y);
    for (int x = 0; x < image.width; ++x) sum[x] = kernel[0] * middle[x];
    for (int i = 1; i <= radius; ++i) {
      AddWeighted(image.Row(std::max(y - i, 0)),
                  image.Row(std::min(y + i, last)),
                  kernel[i],
                  image.width,
                  sum);
    }
    BlurRow(kernel, sum, image.width, &padded, result.Row(y));
  }
  return result;
}

FloatImage Doubled(const FloatImage& image) {
  FloatImage result(2 * image.width, 2 * image.height);
  for (int y = 0; y < result.height; ++y) {
    const float* row = image.Row(y / 2);
    const float* next = image.Row(std::min((y + 1) / 2, image.height - 1));
    float* target = result.Row(y);
    for (int x = 0; x < image.width; ++x) {
      const int right = std::min(x + 1, image.width - 1);
      const float here = 0.5f * (row[x] + next[x]);
      target[2 * x] = here;
      target[2 * x + 1] = 0.5f * (here + 0.5f * (row[right] + next[right]));
    }
  }
  return result;
}

FloatImage Halved(const FloatImage& image) {
  FloatImage result(image.width / 2, image.height / 2);
  for (int y = 0; y < result.height; ++y) {
    for (int x = 0; x < result.width; ++x) {
      result.Row(y)[x] = image.At(2 * x, 2 * y);
    }
  }
  return result;
}

ScaleSpace::ScaleSpace(const FloatImage& image,
                       int first_octave,
                       int resolution)
    : resolution_(resolution) {
  FloatImage first = image;
  for (int i = 0; i > first_octave; --i) first = Doubled(first);
  for (int i = 0; i < first_octave; ++i) first = Halved(first);
  const double sigma = kImageSigma * std::exp2(-first_octave);
  if (sigma < kFirstSigma) {
    first = GaussianBlur(first,
                         std::sqrt(kFirstSigma * kFirstSigma - sigma * sigma));
  }
  octave_.index = first_octave;
  FillLevels(std::move(first));
}

bool ScaleSpace::Next() {
  const FloatImage& twice_the_sigma = octave_.levels[resolution_];
  if (std::min(twice_the_sigma.width, twice_the_sigma.height) < 2 * kMinSide) {
    return false;
  }
  ++octave_.index;
  FillLevels(Halved(twice_the_sigma));
  return true;
}

void ScaleSpace::FillLevels(FloatImage first) {
  octave_.levels.clear();
  octave_.levels.push_back(std::move(first));
  const double factor = std::exp2(1.0 / resolution_);
  double sigma = kFirstSigma;
  for (int i = 1; i < resolution_ + 3; ++i) {
    octave_.levels.push_back(GaussianBlur(
        octave_.levels.back(), sigma * std::sqrt(factor * factor - 1.0)));
    sigma *= factor;
  }
}

}  // namespace mfir
