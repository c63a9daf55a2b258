// Gaussian scale space of an image, octave by octave.

#pragma once

#include <cstddef>
#include <vector>

namespace mfir {

// Row-major, top row first.
struct FloatImage {
  int width = 0;
  int height = 0;
  std::vector<float> pixels;

  FloatImage() = default;
  FloatImage(int image_width, int image_height)
      : width(image_width),
        height(image_height),
        pixels(static_cast<size_t>(image_width) * image_height) {}

  const float* Row(int y) const {
    return pixels.data() + static_cast<size_t>(y) * width;
  }
  float* Row(int y) { return pixels.data() + static_cast<size_t>(y) * width; }
  float At(int x, int y) const { return Row(y)[x]; }
};

// Convolution with a Gaussian of standard deviation `sigma` (pixels), cut off
// at 4 sigma; the border goes on as its last pixel.
FloatImage GaussianBlur(const FloatImage& image, double sigma);

// Twice as many pixels along each side: pixel 2 i is pixel i, those between are
// means. So coordinates of pixel centres, counted from 0, are doubled.
FloatImage Doubled(const FloatImage& image);

// Every other pixel, from the first.
FloatImage Halved(const FloatImage& image);

// Of one octave: images whose blur grows by 2^(1 / resolution) from one to the
// next. Level l has the blur kFirstSigma * 2^(l / resolution) pixels of the
// octave, l = 0 ... resolution + 2.
struct Octave {
  int index = 0;  // pixels are 2^index of the image's
  std::vector<FloatImage> levels;
};

inline constexpr double kFirstSigma = 1.6;

// The octaves from `first_octave` on, as SIFT has them (Lowe 2004); the image
// is taken to be blurred by half a pixel. Only one is in memory at a time.
class ScaleSpace {
 public:
  // No side of the first octave may have fewer than kMinSide pixels.
  ScaleSpace(const FloatImage& image, int first_octave, int resolution);

  const Octave& Current() const { return octave_; }

  // For callers that need some of the levels later. What is moved away must
  // not be level `resolution`, from which the next octave is made.
  Octave& Current() { return octave_; }

  // False if there is none: a side would have fewer than kMinSide pixels.
  bool Next();

  static constexpr int kMinSide = 4;

 private:
  void FillLevels(FloatImage first);

  const int resolution_;
  Octave octave_;
};

}  // namespace mfir
