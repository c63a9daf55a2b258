#include "noise_samples.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

#include "linearization.h"
#include "parallel_for.h"

namespace mfir {
namespace {

constexpr size_t kPointsPerChunk = 1024;
// Of a standard normal variable.
constexpr double kMedianOfSquare = 0.45493642311957283;
constexpr double kMinWeight = 0.05;

// Consecutive points of one frame.
struct Chunk {
  const Frame* frame;
  size_t begin;
  size_t end;
};

std::vector<Chunk> MakeChunks(const Scene& scene) {
  std::vector<Chunk> chunks;
  for (const Frame& frame : scene.frames) {
    for (size_t i = 0; i < frame.points.size(); i += kPointsPerChunk) {
      chunks.push_back(
          {&frame, i, std::min(frame.points.size(), i + kPointsPerChunk)});
    }
  }
  return chunks;
}

// Calls function(chunk, &results) for all chunks and joins the results in
// order.
template <typename T, typename Function>
std::vector<T> CollectInChunks(const Scene& scene,
                               int num_threads,
                               const Function& function) {
  const std::vector<Chunk> chunks = MakeChunks(scene);
  std::vector<std::vector<T>> results(chunks.size());
  ParallelFor(chunks.size(), num_threads, [&](size_t i) {
    function(chunks[i], &results[i]);
  });
  std::vector<T> joined;
  for (const std::vector<T>& result : results) {
    joined.insert(joined.end(), result.begin(), result.end());
  }
  return joined;
}

// Samples of one track; see the header.
void AddSamples(const std::vector<Linearization>& linearizations,
                const ceres::LossFunction* loss,
                std::vector<NoiseSample>* samples) {
  double rho_at_zero[3] = {0.0, 1.0, 0.0};
  if (loss != nullptr) loss->Evaluate(0.0, rho_at_zero);
  std::vector<double> weights;
  Eigen::Matrix3d information = Eigen::Matrix3d::Zero();
  for (const Linearization& linearization : linearizations) {
    double rho[3] = {0.0, 1.0, 0.0};
    if (loss != nullptr) {
      loss->Evaluate(linearization.residual.squaredNorm(), rho);
    }
    weights.push_back(rho[1] / rho_at_zero[1]);
    information += weights.back() * linearization.jacobian_point.transpose() *
                   linearization.jacobian_point;
  }
  const Eigen::LDLT<Eigen::Matrix3d> factorization(information);
  for (size_t k = 0; k < linearizations.size(); ++k) {
    const Matrix2x3& jacobian = linearizations[k].jacobian_point;
    const Eigen::Matrix2d covariance =
        Eigen::Matrix2d::Identity() -
        weights[k] * jacobian * factorization.solve(jacobian.transpose());
    Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> eigen;
    eigen.computeDirect(covariance);
    for (int e = 0; e < 2; ++e) {
      const double weight = std::min(eigen.eigenvalues()(e), 1.0);
      if (!(weight > kMinWeight)) continue;
      const double residual =
          eigen.eigenvectors().col(e).dot(linearizations[k].residual);
      samples->push_back({residual * residual / weight, weight});
    }
  }
}

}  // namespace

std::vector<double> SquaredResiduals(const Scene& scene, int num_threads) {
  const std::vector<CameraState> states = CameraStates(scene);
  return CollectInChunks<double>(
      scene, num_threads, [&](const Chunk& chunk, std::vector<double>* result) {
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
                                           frame.points[i],
                                           &xy)
                                  ? (xy - observation.xy).squaredNorm()
                                  : std::numeric_limits<double>::infinity());
          }
        }
      });
}

std::vector<NoiseSample> NoiseSamples(const Scene& scene,
                                      const ceres::LossFunction* loss,
                                      int num_threads) {
  const std::vector<CameraState> states = CameraStates(scene);
  return CollectInChunks<NoiseSample>(
      scene,
      num_threads,
      [&](const Chunk& chunk, std::vector<NoiseSample>* result) {
        const Frame& frame = *chunk.frame;
        std::vector<Linearization> linearizations;
        for (size_t i = chunk.begin; i < chunk.end; ++i) {
          linearizations.clear();
          for (size_t k = frame.track_begins[i]; k < frame.track_begins[i + 1];
               ++k) {
            const Observation& observation = frame.observations[k];
            const size_t camera_idx =
                frame.images[observation.image_idx].camera_idx;
            Linearization linearization;
            if (LinearizeObservation(*scene.cameras[camera_idx].model,
                                     states[camera_idx],
                                     FreeParams(),
                                     observation.xy,
                                     frame.points[i],
                                     &linearization)) {
              linearizations.push_back(linearization);
            }
          }
          if (linearizations.size() >= 2) {
            AddSamples(linearizations, loss, result);
          }
        }
      });
}

double RobustStd(std::vector<NoiseSample> samples) {
  std::sort(samples.begin(),
            samples.end(),
            [](const NoiseSample& a, const NoiseSample& b) {
              return a.squared < b.squared;
            });
  double total = 0.0;
  for (const NoiseSample& sample : samples) total += sample.weight;
  double sum = 0.0;
  for (const NoiseSample& sample : samples) {
    sum += sample.weight;
    if (sum >= 0.5 * total) {
      return std::sqrt(sample.squared / kMedianOfSquare);
    }
  }
  return 0.0;
}

}  // namespace mfir
