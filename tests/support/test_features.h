// Feature patches for tests, and plain versions of what is computed of them.

#pragma once

#include <cmath>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include <Eigen/Core>

#include "src/dense/cost_map_kernels.h"
#include "src/scene/scene.h"
#include "src/util/random.h"

namespace mfir {

inline std::vector<uint16_t> ToHalf(const std::vector<double>& values) {
  std::vector<uint16_t> halves;
  for (const double value : values) {
    halves.push_back(FloatToHalf(static_cast<float>(value)));
  }
  return halves;
}

inline std::vector<uint16_t> RandomHalves(size_t count, uint64_t seed) {
  Random random({seed, 17});
  std::vector<double> values;
  for (size_t i = 0; i < count; ++i) values.push_back(random.Normal());
  return ToHalf(values);
}

// Features as the columns of a matrix, in double precision.
inline Eigen::MatrixXd ToMatrix(const uint16_t* features,
                                int num_channels,
                                int num_features) {
  Eigen::MatrixXd matrix(num_channels, num_features);
  for (int i = 0; i < num_features; ++i) {
    for (int c = 0; c < num_channels; ++c) {
      matrix(c, i) = HalfToFloat(features[i * num_channels + c]);
    }
  }
  return matrix;
}

// The cost map from its definition: F_u, then (F - f) . F_u / |F - f|.
inline std::vector<double> PlainCostMap(const PatchShape& shape,
                                        double pixel_size,
                                        const uint16_t* patch,
                                        const uint16_t* reference) {
  const int n = shape.patch_size;
  const Eigen::MatrixXd features =
      ToMatrix(patch, shape.num_channels, shape.NumPixels());
  const Eigen::VectorXd f = ToMatrix(reference, shape.num_channels, 1);
  // Derivative along a line of n pixels at its i-th, pixels `stride` apart.
  const auto derivative = [&](int pixel, int i, int stride) -> Eigen::VectorXd {
    const auto at = [&](int offset) {
      return features.col(pixel + offset * stride);
    };
    if (i == 0) return 0.5 * (-3.0 * at(0) + 4.0 * at(1) - at(2));
    if (i == n - 1) return 0.5 * (3.0 * at(0) - 4.0 * at(-1) + at(-2));
    return 0.5 * (at(1) - at(-1));
  };
  std::vector<double> cost_map;
  for (int pixel = 0; pixel < n * n; ++pixel) {
    const Eigen::VectorXd difference = features.col(pixel) - f;
    const double distance = difference.norm();
    cost_map.push_back(distance);
    for (const Eigen::VectorXd& gradient :
         {derivative(pixel, pixel % n, 1), derivative(pixel, pixel / n, n)}) {
      cost_map.push_back(distance == 0.0 ? 0.0
                                         : difference.dot(gradient) /
                                               (distance * pixel_size));
    }
  }
  return cost_map;
}

// Cost maps as of features that localize all points of a frame exactly:
// distance sqrt(floor^2 + |slope (xy - true_xy)|^2) and its derivatives, one
// for each observation, whose true position is that of `truth`.
inline void AddBowlCostMaps(double floor,
                            double slope,
                            const Frame& truth,
                            Frame* frame) {
  constexpr int kSize = 16;
  auto maps = std::make_shared<CostMaps>();
  maps->patch_size = kSize;
  for (size_t k = 0; k < frame->observations.size(); ++k) {
    const Eigen::Vector2d& true_xy = truth.observations[k].xy;
    const Eigen::Vector2d origin =
        frame->observations[k].xy.array().round() - 7.5;
    frame->observations[k].cost_map_idx =
        static_cast<int64_t>(maps->placements.size());
    maps->placements.push_back({origin, 1.0});
    for (int row = 0; row < kSize; ++row) {
      for (int column = 0; column < kSize; ++column) {
        const Eigen::Vector2d d =
            origin + Eigen::Vector2d(column, row) - true_xy;
        const double distance =
            std::sqrt(floor * floor + slope * slope * d.squaredNorm());
        const double factor = slope * slope / distance;
        for (const uint16_t half :
             ToHalf({distance, factor * d.x(), factor * d.y()})) {
          maps->data.push_back(half);
        }
      }
    }
  }
  frame->cost_maps = std::move(maps);
}

}  // namespace mfir
