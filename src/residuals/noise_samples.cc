#include "src/residuals/noise_samples.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

#include "src/parallel/order_statistics.h"
#include "src/parallel/parallel_for.h"
#include "src/residuals/linearization.h"

namespace mfir {
namespace {

constexpr size_t kPointsPerChunk = 1024;
// Of a standard normal variable.
constexpr double kMedianOfSquare = 0.45493642311957283;
constexpr double kMinWeight = 0.05;
// Where just one half of equal weights lies below, no last digit of their sum,
// which depends on its order, may decide.
constexpr double kHalfTolerance = 1e-12;

// Consecutive points of one frame.
struct Chunk {
  const Frame* frame;
  const std::vector<Eigen::Vector3d>* points;
  size_t begin;
  size_t end;
};

std::vector<Chunk> MakeChunks(const Scene& scene, const Estimate& estimate) {
  std::vector<Chunk> chunks;
  for (size_t f = 0; f < scene.frames.size(); ++f) {
    const Frame& frame = scene.frames[f];
    for (size_t i = 0; i < frame.NumPoints(); i += kPointsPerChunk) {
      chunks.push_back({&frame,
                        &estimate.frames[f].points,
                        i,
                        std::min(frame.NumPoints(), i + kPointsPerChunk)});
    }
  }
  return chunks;
}

// In order.
template <typename T>
std::vector<T> Join(const std::vector<std::vector<T>>& parts, int num_threads) {
  std::vector<size_t> begins = {0};
  for (const std::vector<T>& part : parts) {
    begins.push_back(begins.back() + part.size());
  }
  std::vector<T> joined(begins.back());
  ParallelFor(parts.size(), num_threads, [&](size_t i) {
    std::copy(parts[i].begin(), parts[i].end(), joined.begin() + begins[i]);
  });
  return joined;
}

// Calls function(chunk, &results) for all chunks and joins the results in
// order.
template <typename T, typename Function>
std::vector<T> CollectInChunks(const std::vector<Chunk>& chunks,
                               int num_threads,
                               const Function& function) {
  std::vector<std::vector<T>> results(chunks.size());
  ParallelFor(chunks.size(), num_threads, [&](size_t i) {
    function(chunks[i], &results[i]);
  });
  return Join(results, num_threads);
}

// Residual with its derivatives by the point and its weight in the fit.
struct WeightedResidual {
  Eigen::Vector2d residual;
  Matrix2x3 jacobian;
  double weight;
  double weight_at_zero;
  bool is_feature;
};

double Weight(const ceres::LossFunction& loss, double squared_residual) {
  double rho[3];
  loss.Evaluate(squared_residual, rho);
  return rho[1];
}

void AddResiduals(const Linearization& linearization,
                  const Observation& observation,
                  const Frame& frame,
                  const ceres::LossFunction* loss,
                  const ceres::LossFunction* feature_loss,
                  std::vector<WeightedResidual>* residuals) {
  const auto add = [&](const Eigen::Vector2d& residual,
                       const Matrix2x3& jacobian,
                       const ceres::LossFunction* own_loss,
                       double default_weight,
                       bool is_feature) {
    const bool has_loss = own_loss != nullptr;
    residuals->push_back(
        {residual,
         jacobian,
         has_loss ? Weight(*own_loss, residual.squaredNorm()) : default_weight,
         has_loss ? Weight(*own_loss, 0.0) : default_weight,
         is_feature});
  };
  add(linearization.residual, linearization.jacobian_point, loss, 1.0, false);
  if (observation.cost_map_idx < 0 || frame.feature_keypoints.empty()) return;
  const FeatureKeypoint& feature =
      frame.feature_keypoints[static_cast<size_t>(observation.cost_map_idx)];
  add(feature.whitening *
          (linearization.residual + observation.xy - feature.xy),
      feature.whitening * linearization.jacobian_point,
      feature_loss,
      0.0,
      true);
}

// Samples of one track; see the header.
void AddSamples(const std::vector<WeightedResidual>& residuals,
                NoiseSampleSets* samples) {
  Eigen::Matrix3d information = Eigen::Matrix3d::Zero();
  for (const WeightedResidual& residual : residuals) {
    information +=
        residual.weight * residual.jacobian.transpose() * residual.jacobian;
  }
  const Eigen::LDLT<Eigen::Matrix3d> factorization(information);
  for (const WeightedResidual& residual : residuals) {
    const Matrix2x3& jacobian = residual.jacobian;
    const Eigen::Matrix2d covariance =
        Eigen::Matrix2d::Identity() -
        residual.weight * jacobian * factorization.solve(jacobian.transpose());
    Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> eigen;
    eigen.computeDirect(covariance);
    for (int e = 0; e < 2; ++e) {
      const double weight = std::min(eigen.eigenvalues()(e), 1.0);
      const Eigen::Vector2d direction = eigen.eigenvectors().col(e);
      if (!(weight > kMinWeight)) continue;
      const double projected = direction.dot(residual.residual);
      const NoiseSample sample = {projected * projected / weight, weight};
      if (!residual.is_feature) {
        samples->keypoints.push_back(sample);
      } else if ((direction.transpose() * jacobian).squaredNorm() > 0.0) {
        samples->features.push_back(sample);
      }
    }
  }
}

}  // namespace

std::vector<double> SquaredResiduals(const Scene& scene,
                                     const Estimate& estimate,
                                     int num_threads) {
  const std::vector<CameraState> states = CameraStates(estimate.cameras);
  return CollectInChunks<double>(
      MakeChunks(scene, estimate),
      num_threads,
      [&](const Chunk& chunk, std::vector<double>* result) {
        const Frame& frame = *chunk.frame;
        for (size_t i = chunk.begin; i < chunk.end; ++i) {
          for (size_t k = frame.track_begins[i]; k < frame.track_begins[i + 1];
               ++k) {
            const Observation& observation = frame.observations[k];
            const size_t camera_idx =
                frame.images[observation.image_idx].camera_idx;
            Eigen::Vector2d xy;
            result->push_back(ProjectPoint(*scene.cameras[camera_idx].model,
                                           states[camera_idx],
                                           (*chunk.points)[i],
                                           &xy)
                                  ? (xy - observation.xy).squaredNorm()
                                  : std::numeric_limits<double>::infinity());
          }
        }
      });
}

NoiseSampleSets NoiseSamples(const Scene& scene,
                             const Estimate& estimate,
                             const ceres::LossFunction* loss,
                             const ceres::LossFunction* feature_loss,
                             int num_threads) {
  const std::vector<CameraState> states = CameraStates(estimate.cameras);
  const std::vector<Chunk> chunks = MakeChunks(scene, estimate);
  std::vector<std::vector<NoiseSample>> keypoints(chunks.size());
  std::vector<std::vector<NoiseSample>> features(chunks.size());
  ParallelFor(chunks.size(), num_threads, [&](size_t c) {
    const Frame& frame = *chunks[c].frame;
    NoiseSampleSets sets;
    std::vector<WeightedResidual> residuals;
    for (size_t i = chunks[c].begin; i < chunks[c].end; ++i) {
      residuals.clear();
      size_t num_observations = 0;
      for (size_t k = frame.track_begins[i]; k < frame.track_begins[i + 1];
           ++k) {
        const Observation& observation = frame.observations[k];
        const size_t camera_idx =
            frame.images[observation.image_idx].camera_idx;
        Linearization linearization;
        if (!LinearizeObservation(*scene.cameras[camera_idx].model,
                                  states[camera_idx],
                                  FreeParams(),
                                  observation.xy,
                                  (*chunks[c].points)[i],
                                  &linearization)) {
          continue;
        }
        ++num_observations;
        AddResiduals(
            linearization, observation, frame, loss, feature_loss, &residuals);
      }
      if (num_observations < 2) continue;
      // Relative to keypoints.
      const double unit = residuals[0].weight_at_zero;
      for (WeightedResidual& residual : residuals) residual.weight /= unit;
      AddSamples(residuals, &sets);
    }
    keypoints[c] = std::move(sets.keypoints);
    features[c] = std::move(sets.features);
  });
  return {Join(keypoints, num_threads), Join(features, num_threads)};
}

double RobustStd(const std::vector<NoiseSample>& samples,
                 const Communicator& ranks,
                 int num_threads) {
  double total = 0.0;
  for (const NoiseSample& sample : samples) total += sample.weight;
  total = Sum(ranks, total);
  if (total == 0.0) return 0.0;
  const double median = ValueAtWeight(
      samples.size(),
      [&](size_t i) {
        return WeightedValue{samples[i].squared, samples[i].weight};
      },
      (0.5 - kHalfTolerance) * total,
      ranks,
      num_threads);
  return std::sqrt(median / kMedianOfSquare);
}

}  // namespace mfir
