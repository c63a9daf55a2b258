#include "src/scene/residual_statistics.h"

#include <cmath>

#include "src/parallel/order_statistics.h"

namespace mfir {

double MaxInlierSquaredResidual(const std::vector<double>& squared_residuals,
                                const Communicator& ranks,
                                int num_threads) {
  constexpr double kMaxStds = 4.0;
  if (Sum(ranks, squared_residuals.size()) == 0) return 0.0;
  // |r|^2 of 2D Gaussian noise has the median 2 ln(2) sigma^2.
  return kMaxStds * kMaxStds * Median(squared_residuals, ranks, num_threads) /
         (2.0 * std::log(2.0));
}

double InlierRms(const std::vector<double>& squared_residuals,
                 const Communicator& ranks,
                 int num_threads) {
  const double max_squared =
      MaxInlierSquaredResidual(squared_residuals, ranks, num_threads);
  double sum = 0.0;
  double count = 0.0;
  for (const double squared : squared_residuals) {
    if (!std::isfinite(squared) || squared > max_squared) continue;
    sum += squared;
    count += 1.0;
  }
  return std::sqrt(Sum(ranks, sum) / Sum(ranks, count));
}

std::vector<double> RmsByCamera(const Scene& scene,
                                const std::vector<double>& squared_residuals,
                                const std::vector<bool>& selected) {
  std::vector<double> sums(scene.cameras.size() + 1, 0.0);
  std::vector<double> counts(scene.cameras.size() + 1, 0.0);
  size_t k = 0;
  for (const Frame& frame : scene.frames) {
    for (const Observation& observation : frame.observations) {
      const size_t camera_idx = frame.images[observation.image_idx].camera_idx;
      if (selected[k] && std::isfinite(squared_residuals[k])) {
        for (const size_t idx : {camera_idx, scene.cameras.size()}) {
          sums[idx] += squared_residuals[k];
          counts[idx] += 1.0;
        }
      }
      ++k;
    }
  }
  scene.ranks->Sum(sums.data(), sums.size());
  scene.ranks->Sum(counts.data(), counts.size());
  for (size_t i = 0; i < sums.size(); ++i) {
    sums[i] = std::sqrt(sums[i] / counts[i]);  // NaN without observations
  }
  return sums;
}

std::vector<size_t> NumObservationsByCamera(const Scene& scene) {
  std::vector<size_t> numbers(scene.cameras.size(), 0);
  for (const Frame& frame : scene.frames) {
    for (const Observation& observation : frame.observations) {
      ++numbers[frame.images[observation.image_idx].camera_idx];
    }
  }
  return Sum(*scene.ranks, numbers);
}

}  // namespace mfir
