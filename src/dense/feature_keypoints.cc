#include "src/dense/feature_keypoints.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include <Eigen/Dense>
#include <Eigen/Eigenvalues>

#include "src/parallel/parallel_for.h"
#include "src/util/half_float.h"
#include "src/util/median.h"

namespace mfir {
namespace {

constexpr int kSearchRadius = 4;  // elements
constexpr int kFitRadius = 2;
constexpr int kFitWidth = 2 * kFitRadius + 1;
constexpr double kMaxFitOffset = 1.5;
// Directions with less information than this times the typical one are vague.
constexpr double kMinRelativeInformation = 0.04;

using FitMatrix = Eigen::Matrix<double, 6, kFitWidth * kFitWidth>;

// Coefficients of c + g^T q + 1/2 (a qx^2 + 2 b qx qy + d qy^2) as linear
// functions of the values at the nodes of the window, row by row.
FitMatrix MakeFitMatrix() {
  Eigen::Matrix<double, kFitWidth * kFitWidth, 6> basis;
  int k = 0;
  for (int y = -kFitRadius; y <= kFitRadius; ++y) {
    for (int x = -kFitRadius; x <= kFitRadius; ++x) {
      basis.row(k++) << 1.0, x, y, 0.5 * x * x, x * y, 0.5 * y * y;
    }
  }
  return (basis.transpose() * basis).inverse() * basis.transpose();
}

struct FoundMinimum {
  const Observation* observation;
  CostMapMinimum minimum;
};

std::vector<FoundMinimum> FindMinima(const Frame& frame) {
  std::vector<FoundMinimum> minima;
  for (const Observation& observation : frame.observations) {
    if (observation.cost_map_idx < 0) continue;
    FoundMinimum found = {&observation, {}};
    if (FindCostMapMinimum(*frame.cost_maps,
                           static_cast<size_t>(observation.cost_map_idx),
                           observation.xy,
                           &found.minimum)) {
      minima.push_back(found);
    }
  }
  return minima;
}

// Square root of the information relative to `typical`, without directions that
// have too little.
Eigen::Matrix2d Whitening(const Eigen::Matrix2d& information, double typical) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> eigen(information /
                                                             typical);
  Eigen::Vector2d roots;
  for (int i = 0; i < 2; ++i) {
    const double value = eigen.eigenvalues()(i);
    roots(i) = value > kMinRelativeInformation ? std::sqrt(value) : 0.0;
  }
  return roots.asDiagonal() * eigen.eigenvectors().transpose();
}

}  // namespace

bool FindCostMapMinimum(const CostMaps& cost_maps,
                        size_t idx,
                        const Eigen::Vector2d& keypoint,
                        CostMapMinimum* minimum) {
  static const FitMatrix fit_matrix = MakeFitMatrix();
  const int size = cost_maps.patch_size;
  const CostMaps::Placement& placement = cost_maps.placements[idx];
  const uint16_t* map = cost_maps.Data(idx);
  const auto squared_distance = [&](int x, int y) {
    const double distance = HalfToFloat(map[3 * (y * size + x)]);
    return distance * distance;
  };
  const Eigen::Vector2d center =
      (keypoint - placement.origin) / placement.pixel_size;
  if (!center.allFinite()) return false;
  const auto range = [&](double position) {
    const double low = std::max<double>(kFitRadius, position - kSearchRadius);
    const double high =
        std::min<double>(size - 1 - kFitRadius, position + kSearchRadius);
    return std::make_pair(static_cast<int>(std::ceil(low)),
                          static_cast<int>(std::floor(high)));
  };
  const auto [min_x, max_x] = range(center.x());
  const auto [min_y, max_y] = range(center.y());
  double smallest = std::numeric_limits<double>::infinity();
  Eigen::Vector2i node(0, 0);
  for (int y = min_y; y <= max_y; ++y) {
    for (int x = min_x; x <= max_x; ++x) {
      if (squared_distance(x, y) < smallest) {
        smallest = squared_distance(x, y);
        node = {x, y};
      }
    }
  }
  if (!std::isfinite(smallest)) return false;

  Eigen::Matrix<double, kFitWidth * kFitWidth, 1> values;
  int k = 0;
  for (int y = -kFitRadius; y <= kFitRadius; ++y) {
    for (int x = -kFitRadius; x <= kFitRadius; ++x) {
      values(k++) = squared_distance(node.x() + x, node.y() + y);
    }
  }
  const Eigen::Matrix<double, 6, 1> fit = fit_matrix * values;
  Eigen::Matrix2d hessian;
  hessian << fit(3), fit(4), fit(4), fit(5);
  const Eigen::LLT<Eigen::Matrix2d> factorization(hessian);
  if (!fit.allFinite() || factorization.info() != Eigen::Success) return false;
  const Eigen::Vector2d gradient = fit.segment<2>(1);
  const Eigen::Vector2d offset = -factorization.solve(gradient);
  if (!(offset.cwiseAbs().maxCoeff() <= kMaxFitOffset)) return false;
  minimum->xy =
      placement.origin + placement.pixel_size * (node.cast<double>() + offset);
  minimum->sharpness =
      0.5 * hessian / (placement.pixel_size * placement.pixel_size);
  minimum->min_squared_distance =
      std::max(fit(0) + 0.5 * gradient.dot(offset), 0.0);
  return true;
}

Scene FindFeatureKeypoints(int num_threads, Scene scene) {
  std::vector<std::vector<FoundMinimum>> minima(scene.frames.size());
  ParallelFor(scene.frames.size(), num_threads, [&](size_t i) {
    if (scene.frames[i].cost_maps != nullptr) {
      minima[i] = FindMinima(scene.frames[i]);
    }
  });
  std::vector<double> squared_distances;
  for (const auto& frame_minima : minima) {
    for (const FoundMinimum& found : frame_minima) {
      squared_distances.push_back(found.minimum.min_squared_distance);
    }
  }
  if (squared_distances.empty()) return scene;
  const double typical_distance =
      std::max(UpperMedian(std::move(squared_distances)), 1e-12);
  const auto information = [&](const CostMapMinimum& minimum) {
    const double noise = minimum.min_squared_distance + typical_distance;
    return Eigen::Matrix2d(minimum.sharpness / noise);
  };
  std::vector<double> informations;
  for (const auto& frame_minima : minima) {
    for (const FoundMinimum& found : frame_minima) {
      informations.push_back(0.5 * information(found.minimum).trace());
    }
  }
  const double typical = UpperMedian(std::move(informations));
  for (size_t i = 0; i < scene.frames.size(); ++i) {
    Frame& frame = scene.frames[i];
    if (frame.cost_maps == nullptr) continue;
    frame.feature_keypoints.assign(frame.cost_maps->placements.size(), {});
    for (const FoundMinimum& found : minima[i]) {
      FeatureKeypoint& keypoint = frame.feature_keypoints[static_cast<size_t>(
          found.observation->cost_map_idx)];
      keypoint.xy = found.minimum.xy;
      keypoint.whitening = Whitening(information(found.minimum), typical);
    }
  }
  return scene;
}

}  // namespace mfir
