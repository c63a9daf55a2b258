#include "src/geometry/epipolar_tolerance.h"

#include <algorithm>
#include <cmath>

namespace mfir {
namespace {

// The most surprising set ends where the density of right matches falls below
// about a quarter of its mean, near two standard deviations of them.
constexpr double kTailFactor = 1.5;

}  // namespace

Eigen::Matrix3d EssentialMatrix(const Rigid3& cam1_from_world,
                                const Rigid3& cam2_from_world) {
  const Eigen::Matrix3d rotation =
      (cam2_from_world.rotation * cam1_from_world.rotation.conjugate())
          .toRotationMatrix();
  // A unit baseline: only the direction counts.
  const Eigen::Vector3d t =
      (cam2_from_world.translation - rotation * cam1_from_world.translation)
          .normalized();
  Eigen::Matrix3d cross;
  cross << 0.0, -t.z(), t.y(), t.z(), 0.0, -t.x(), -t.y(), t.x(), 0.0;
  return cross * rotation;
}

double EpipolarError(const Eigen::Matrix3d& essential_matrix,
                     const Eigen::Vector3d& ray1,
                     const Eigen::Vector3d& ray2,
                     double focal_length1,
                     double focal_length2) {
  const Eigen::Vector3d normal2 = essential_matrix * ray1;
  const Eigen::Vector3d normal1 = essential_matrix.transpose() * ray2;
  const double value = ray2.dot(normal2);
  // Gradients along the sphere, per pixel.
  const double gradient2 =
      (normal2.squaredNorm() - value * value) / (focal_length2 * focal_length2);
  const double gradient1 =
      (normal1.squaredNorm() - value * value) / (focal_length1 * focal_length1);
  // Both at the epipoles: any match fits.
  const double gradient = std::max(gradient1 + gradient2, 1e-300);
  return std::abs(value) / std::sqrt(gradient);
}

double LogNumFalseAlarms(
    size_t n, size_t k, double tolerance, double share, double max_error) {
  // std::lgamma writes a global sign, which is a race between threads.
  const auto log_gamma = [](double x) {
    int sign = 0;
    return lgamma_r(x, &sign);
  };
  const double log_choose =
      log_gamma(n + 1.0) - log_gamma(k + 1.0) - log_gamma(n - k + 1.0);
  return log_choose + k * std::log(share * tolerance / max_error);
}

EpipolarTolerance EstimateEpipolarTolerance(std::vector<double> errors,
                                            double share,
                                            double min_error,
                                            double max_error) {
  std::sort(errors.begin(), errors.end());
  EpipolarTolerance best;
  best.tolerance = min_error;
  for (size_t i = 0; i < errors.size() && errors[i] <= max_error; ++i) {
    const double tolerance = std::max(errors[i], min_error);
    const double log_nfa =
        LogNumFalseAlarms(errors.size(), i + 1, tolerance, share, max_error);
    if (log_nfa < best.log_nfa) {
      best.log_nfa = log_nfa;
      best.tolerance = tolerance;
    }
  }
  best.tolerance = std::min(kTailFactor * best.tolerance, max_error);
  best.num_inliers = static_cast<size_t>(
      std::upper_bound(errors.begin(), errors.end(), best.tolerance) -
      errors.begin());
  return best;
}

}  // namespace mfir
