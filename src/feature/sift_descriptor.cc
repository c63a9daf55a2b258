#include "src/feature/sift_descriptor.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace mfir {
namespace {

constexpr float kTwoPi = static_cast<float>(2.0 * M_PI);

// Orientations.
constexpr int kNumAngleBins = 36;
constexpr double kWindowFactor = 1.5;
constexpr int kNumSmoothings = 6;
constexpr double kPeakRatio = 0.8;
constexpr size_t kMaxNumOrientations = 4;

// Descriptors.
constexpr int kNumBins = 4;  // along each side
constexpr int kNumDirections = 8;
constexpr float kBinSize = 3.0f;  // in units of sigma
constexpr float kMaxElement = 0.2f;

struct Gradient {
  float x;
  float y;
};

// One-sided at the border.
Gradient GradientAt(const FloatImage& image, int x, int y) {
  const int left = std::max(x - 1, 0);
  const int right = std::min(x + 1, image.width - 1);
  const int up = std::max(y - 1, 0);
  const int down = std::min(y + 1, image.height - 1);
  return {
      (image.At(right, y) - image.At(left, y)) /
          static_cast<float>(right - left),
      (image.At(x, down) - image.At(x, up)) / static_cast<float>(down - up)};
}

// In [0, 2 pi], to 1e-4: a polynomial for the octant. Without branches.
inline float Angle(float y, float x) {
  const float abs_x = std::abs(x);
  const float abs_y = std::abs(y);
  const float longer = abs_x > abs_y ? abs_x : abs_y;
  const float shorter = abs_x > abs_y ? abs_y : abs_x;
  const float t = shorter / (longer + 1e-30f);
  const float t2 = t * t;
  const float octant =
      t * (0.9998660f +
           t2 * (-0.3302995f +
                 t2 * (0.1801410f + t2 * (-0.0851330f + t2 * 0.0208351f))));
  const float quadrant = abs_y > abs_x ? 0.25f * kTwoPi - octant : octant;
  const float half = x < 0.0f ? 0.5f * kTwoPi - quadrant : quadrant;
  return y < 0.0f ? kTwoPi - half : half;
}

// Not std::clamp, whose references keep loops from being vectorized.
inline float Clamp(float value, float limit) {
  const float upper = value < limit ? value : limit;
  return upper > -limit ? upper : -limit;
}

// exp(-x) for x in [0, 2], to 1e-4.
inline float ExpOfMinus(float x) {
  const float u = -0.25f * x;
  const float quarter =
      1.0f + u * (1.0f + u * (0.5f + u * (1.0f / 6.0f + u * (1.0f / 24.0f))));
  const float half = quarter * quarter;
  return half * half;
}

std::array<double, kNumAngleBins> AngleHistogram(const FloatImage& image,
                                                 const SiftFrame& frame) {
  std::array<double, kNumAngleBins> histogram = {};
  const double window_sigma = kWindowFactor * frame.sigma;
  const int radius = std::max(1, static_cast<int>(3.0 * window_sigma));
  const int xi = static_cast<int>(frame.x + 0.5);
  const int yi = static_cast<int>(frame.y + 0.5);
  for (int y = std::max(yi - radius, 0);
       y <= std::min(yi + radius, image.height - 1);
       ++y) {
    for (int x = std::max(xi - radius, 0);
         x <= std::min(xi + radius, image.width - 1);
         ++x) {
      const double dx = x - frame.x;
      const double dy = y - frame.y;
      const double r2 = dx * dx + dy * dy;
      if (r2 >= radius * radius + 0.6) continue;
      const Gradient gradient = GradientAt(image, x, y);
      const double weight =
          std::exp(-r2 / (2.0 * window_sigma * window_sigma)) *
          std::hypot(gradient.x, gradient.y);
      const double position =
          kNumAngleBins * Angle(gradient.y, gradient.x) / (2.0 * M_PI) - 0.5;
      const int bin = static_cast<int>(std::floor(position));
      const double share = position - bin;
      histogram[(bin + kNumAngleBins) % kNumAngleBins] +=
          (1.0 - share) * weight;
      histogram[(bin + 1) % kNumAngleBins] += share * weight;
    }
  }
  return histogram;
}

void SmoothCircularly(std::array<double, kNumAngleBins>* histogram) {
  const std::array<double, kNumAngleBins> before = *histogram;
  for (int i = 0; i < kNumAngleBins; ++i) {
    (*histogram)[i] = (before[(i + kNumAngleBins - 1) % kNumAngleBins] +
                       before[i] + before[(i + 1) % kNumAngleBins]) /
                      3.0;
  }
}

// A histogram with a margin of one bin, so that samples need no tests.
class DescriptorHistogram {
 public:
  // Coordinates in bins: 0 to 4 is inside of the descriptor, and its bins are
  // centred at 0.5, 1.5, ... `direction` in [0, 8].
  void Add(float column, float row, float direction, float weight) {
    // All are positive with the margin.
    const float column_position = column + 0.5f;
    const float row_position = row + 0.5f;
    const int c = static_cast<int>(column_position);
    const int r = static_cast<int>(row_position);
    const int d = static_cast<int>(direction);
    const float column_share = column_position - static_cast<float>(c);
    const float row_share = row_position - static_cast<float>(r);
    const float direction_share = direction - static_cast<float>(d);
    const float upper = weight * (1.0f - row_share);
    const float lower = weight * row_share;
    AddToBin(r, c, d, direction_share, upper * (1.0f - column_share));
    AddToBin(r, c + 1, d, direction_share, upper * column_share);
    AddToBin(r + 1, c, d, direction_share, lower * (1.0f - column_share));
    AddToBin(r + 1, c + 1, d, direction_share, lower * column_share);
  }

  // Directions change their sense.
  std::array<float, kSiftDescriptorSize> Values() const {
    std::array<float, kSiftDescriptorSize> values;
    for (int r = 0; r < kNumBins; ++r) {
      for (int c = 0; c < kNumBins; ++c) {
        for (int d = 0; d < kNumDirections; ++d) {
          const int source = (kNumDirections - d) % kNumDirections;
          float value = bins_[r + 1][c + 1][source];
          // The last ones are the first of the next turn.
          if (source < 2) value += bins_[r + 1][c + 1][kNumDirections + source];
          values[kNumDirections * (kNumBins * r + c) + d] = value;
        }
      }
    }
    return values;
  }

 private:
  void AddToBin(int r, int c, int d, float direction_share, float weight) {
    bins_[r][c][d] += (1.0f - direction_share) * weight;
    bins_[r][c][d + 1] += direction_share * weight;
  }

  float bins_[kNumBins + 2][kNumBins + 2][kNumDirections + 2] = {};
};

// Where the samples of a descriptor lie.
class DescriptorWindow {
 public:
  DescriptorWindow(const SiftFrame& frame, double orientation)
      : bin_size_(kBinSize * static_cast<float>(frame.sigma)),
        cosine_(static_cast<float>(std::cos(orientation)) / bin_size_),
        sine_(static_cast<float>(std::sin(orientation)) / bin_size_),
        turn_(static_cast<float>(orientation -
                                 2.0 * M_PI *
                                     std::floor(orientation / (2.0 * M_PI)))) {}

  // Pixels.
  int Radius() const {
    return static_cast<int>(std::sqrt(2.0f) * bin_size_ * kMaxOffset + 0.5f);
  }

  // The x of a row that are inside, pixels from the keypoint.
  std::pair<float, float> Range(float dy) const {
    std::pair<float, float> range(-2.0f * Radius(), 2.0f * Radius());
    const auto cut = [&range](float slope, float offset) {
      if (std::abs(slope) < 1e-12f) {
        if (std::abs(offset) >= kMaxOffset) range.second = range.first - 1.0f;
        return;
      }
      const float a = (-kMaxOffset - offset) / slope;
      const float b = (kMaxOffset - offset) / slope;
      range.first = std::max(range.first, std::min(a, b));
      range.second = std::min(range.second, std::max(a, b));
    };
    cut(cosine_, sine_ * dy);
    cut(-sine_, cosine_ * dy);
    return range;
  }

  // Of the turn from offsets in pixels to bins, from the middle of the
  // descriptor.
  float Cosine() const { return cosine_; }
  float Sine() const { return sine_; }
  float Turn() const { return turn_; }  // in [0, 2 pi]

  static constexpr float kMaxOffset = 0.5f * (kNumBins + 1);  // bins

 private:
  const float bin_size_;  // pixels
  const float cosine_;    // per pixel
  const float sine_;
  const float turn_;
};

// The samples of a row. In arrays, so that compilers vectorize what is computed
// for each.
class DescriptorSamples {
 public:
  // `row`: the first pixel; dx, dy: its offset from the keypoint, pixels.
  void Compute(const DescriptorWindow& window,
               const float* row,
               int width,
               float dx,
               float dy,
               int count) {
    if (static_cast<int>(weights_.size()) < count) {
      for (auto* values : {&columns_, &rows_, &directions_, &weights_}) {
        values->resize(count);
      }
    }
    constexpr float kHalf = 0.5f * kNumBins;
    // Rounding must not lead out of the histogram.
    constexpr float kMax = DescriptorWindow::kMaxOffset - 1e-4f;
    const float cosine = window.Cosine();
    const float sine = window.Sine();
    const float turn = window.Turn();
    // Compilers have to see that these do not overlap.
    float* __restrict columns = columns_.data();
    float* __restrict rows = rows_.data();
    float* __restrict directions = directions_.data();
    float* __restrict weights = weights_.data();
    const float* above = row - width;
    const float* below = row + width;
    for (int i = 0; i < count; ++i) {
      const float x = dx + static_cast<float>(i);
      const float u = Clamp(cosine * x + sine * dy, kMax);
      const float v = Clamp(cosine * dy - sine * x, kMax);
      const float gradient_x = 0.5f * (row[i + 1] - row[i - 1]);
      const float gradient_y = 0.5f * (below[i] - above[i]);
      const float angle = Angle(gradient_y, gradient_x) - turn;
      columns[i] = u + kHalf;
      rows[i] = v + kHalf;
      directions[i] =
          (angle < 0.0f ? angle + kTwoPi : angle) * (kNumDirections / kTwoPi);
      // The window's sigma is half of the descriptor: 2 bins.
      weights[i] = ExpOfMinus((u * u + v * v) / (0.5f * kNumBins * kNumBins)) *
                   std::sqrt(gradient_x * gradient_x + gradient_y * gradient_y);
    }
  }

  void AddTo(int i, DescriptorHistogram* histogram) const {
    histogram->Add(columns_[i], rows_[i], directions_[i], weights_[i]);
  }

 private:
  std::vector<float> columns_;
  std::vector<float> rows_;
  std::vector<float> directions_;
  std::vector<float> weights_;
};

void Normalize(std::array<float, kSiftDescriptorSize>* values) {
  float squared_norm = 0.0f;
  for (const float value : *values) squared_norm += value * value;
  const float factor = 1.0f / std::max(std::sqrt(squared_norm), 1e-12f);
  for (float& value : *values) value *= factor;
}

}  // namespace

std::vector<double> SiftOrientations(const FloatImage& image,
                                     const SiftFrame& frame) {
  std::array<double, kNumAngleBins> histogram = AngleHistogram(image, frame);
  for (int i = 0; i < kNumSmoothings; ++i) SmoothCircularly(&histogram);
  const double largest = *std::max_element(histogram.begin(), histogram.end());
  std::vector<double> angles;
  for (int i = 0; i < kNumAngleBins && angles.size() < kMaxNumOrientations;
       ++i) {
    const double here = histogram[i];
    const double before = histogram[(i + kNumAngleBins - 1) % kNumAngleBins];
    const double after = histogram[(i + 1) % kNumAngleBins];
    if (here > kPeakRatio * largest && here > before && here > after) {
      const double offset =
          -0.5 * (after - before) / (after + before - 2.0 * here);
      angles.push_back(2.0 * M_PI * (i + offset + 0.5) / kNumAngleBins);
    }
  }
  return angles;
}

std::array<float, kSiftDescriptorSize> SiftDescriptor(const FloatImage& image,
                                                      const SiftFrame& frame,
                                                      double orientation) {
  const DescriptorWindow window(frame, orientation);
  const int xi = static_cast<int>(frame.x + 0.5);
  const int yi = static_cast<int>(frame.y + 0.5);
  const int radius = window.Radius();
  DescriptorHistogram histogram;
  DescriptorSamples samples;
  for (int y = std::max(yi - radius, 1);
       y <= std::min(yi + radius, image.height - 2);
       ++y) {
    const auto dy = static_cast<float>(y - frame.y);
    const auto [first_dx, last_dx] = window.Range(dy);
    const int begin = std::max(
        {xi - radius, 1, static_cast<int>(std::ceil(frame.x + first_dx))});
    const int end = std::min({xi + radius,
                              image.width - 2,
                              static_cast<int>(std::floor(frame.x + last_dx))});
    if (begin > end) continue;
    const int count = end - begin + 1;
    samples.Compute(window,
                    image.Row(y) + begin,
                    image.width,
                    static_cast<float>(begin - frame.x),
                    dy,
                    count);
    for (int i = 0; i < count; ++i) samples.AddTo(i, &histogram);
  }
  std::array<float, kSiftDescriptorSize> values = histogram.Values();
  Normalize(&values);
  for (float& value : values) value = std::min(value, kMaxElement);
  Normalize(&values);
  return values;
}

}  // namespace mfir
