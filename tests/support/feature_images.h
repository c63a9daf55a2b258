// Images with exactly known content, and access to the descriptors of patches.

#pragma once

#include <cmath>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <Eigen/Core>

#include "colmap_ext/host/image_file.h"
#include "src/dense/dense_features.h"

namespace mfir {

// Coordinates are COLMAP's: the centre of the top-left pixel is (0.5, 0.5).
struct TestImage {
  int width;
  int height;
  int num_channels;             // 1 or 3
  std::vector<uint8_t> values;  // row-major, channels red, green, blue

  static TestImage Constant(int width, int height, uint8_t value) {
    return {width,
            height,
            1,
            std::vector<uint8_t>(static_cast<size_t>(width) * height, value)};
  }

  static TestImage Blob(int width,
                        int height,
                        const Eigen::Vector2d& center,
                        double sigma) {
    TestImage image = Constant(width, height, 0);
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        const double squared =
            (Eigen::Vector2d(x + 0.5, y + 0.5) - center).squaredNorm();
        image.Pixel(x, y) = static_cast<uint8_t>(std::lround(
            20.0 + 220.0 * std::exp(-0.5 * squared / (sigma * sigma))));
      }
    }
    return image;
  }

  // A smooth texture that is moved by (dx, dy) pixels.
  static TestImage Texture(
      int width, int height, double dx, double dy, int num_channels = 1) {
    TestImage image{width, height, num_channels, {}};
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        for (int c = 0; c < num_channels; ++c) {
          const double u = x + 0.5 - dx + 7.0 * c;
          const double v = y + 0.5 - dy;
          image.values.push_back(static_cast<uint8_t>(std::lround(
              128.0 + 40.0 * std::sin(0.9 * u + 0.3 * v) +
              40.0 * std::sin(0.5 * v - 0.37 * u + 1.0) +
              40.0 * std::sin(0.11 * u) * std::cos(0.8 * v + 0.05 * u))));
        }
      }
    }
    return image;
  }

  uint8_t& Pixel(int x, int y, int channel = 0) {
    return values[(static_cast<size_t>(y) * width + x) * num_channels +
                  channel];
  }
  uint8_t Pixel(int x, int y, int channel = 0) const {
    return const_cast<TestImage*>(this)->Pixel(x, y, channel);
  }

  void Write(const std::string& path) const {
    host::Bitmap bitmap = host::MakeBitmap(width, height, num_channels == 3);
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        const int last = num_channels - 1;
        bitmap.SetPixel(x,
                        y,
                        host::BitmapColor(Pixel(x, y),
                                          Pixel(x, y, std::min(1, last)),
                                          Pixel(x, y, last)));
      }
    }
    ASSERT_TRUE(bitmap.Write(path));
  }

  // Keypoint ids are 0, 10, 20, ...
  DenseFeatureRequest Request(const std::string& name,
                              const Keypoints& keypoints) const {
    DenseFeatureRequest request{
        "000012", "7", name, width, height, keypoints, {}};
    for (size_t i = 0; i < keypoints.size(); ++i) {
      request.keypoint_ids.push_back(static_cast<uint32_t>(10 * i));
    }
    return request;
  }
};

inline std::vector<float> Descriptor(const DenseFeaturePatches& patches,
                                     size_t i,
                                     int column,
                                     int row) {
  const size_t offset =
      ((i * patches.patch_size + row) * patches.patch_size + column) *
      patches.num_channels;
  std::vector<float> values;
  for (int c = 0; c < patches.num_channels; ++c) {
    values.push_back(static_cast<float>(
        Eigen::numext::bit_cast<Eigen::half>(patches.data[offset + c])));
  }
  return values;
}

inline double DescriptorDistance(const std::vector<float>& a,
                                 const std::vector<float>& b) {
  EXPECT_EQ(a.size(), b.size());
  double squared = 0.0;
  for (size_t i = 0; i < a.size(); ++i) squared += std::pow(a[i] - b[i], 2);
  return std::sqrt(squared);
}

}  // namespace mfir
