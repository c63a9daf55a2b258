#include "src/sensor/camera_conversion.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <Eigen/Dense>

#include "src/util/errors.h"

namespace mfir {
namespace {

constexpr int kGridSize = 20;
constexpr int kMaxNumIterations = 100;
constexpr double kTolerance = 1e-12;

}  // namespace

std::vector<double> ConvertCameraParams(
    const CameraModel& source,
    const std::vector<double>& source_params,
    size_t width,
    size_t height,
    const CameraModel& target) {
  const auto mean = [&](const std::vector<size_t>& idxs) {
    double sum = 0.0;
    for (const size_t idx : idxs) sum += source_params[idx];
    return sum / static_cast<double>(idxs.size());
  };
  // Start: focal length and principal point as they are, and distortion just
  // off zero; COLMAP's FOV model is another function close to zero.
  std::vector<double> params(target.NumParams(),
                             target.Name() == "FOV" ? 0.5 : 1e-3);
  for (size_t i = 0; i < target.FocalLengthIdxs().size(); ++i) {
    params[target.FocalLengthIdxs()[i]] =
        source.FocalLengthIdxs().size() == target.FocalLengthIdxs().size()
            ? source_params[source.FocalLengthIdxs()[i]]
            : mean(source.FocalLengthIdxs());
  }
  for (size_t i = 0; i < 2; ++i) {
    params[target.PrincipalPointIdxs()[i]] =
        source_params[source.PrincipalPointIdxs()[i]];
  }

  const Eigen::Index num_rows = 2 * kGridSize * kGridSize;
  const Eigen::Index num_params = static_cast<Eigen::Index>(params.size());
  // Ray (u, v) and pixel (x, y).
  Eigen::Matrix4Xd samples(4, kGridSize * kGridSize);
  for (int i = 0; i < kGridSize; ++i) {
    for (int j = 0; j < kGridSize; ++j) {
      auto sample = samples.col(i * kGridSize + j);
      sample(2) = (i + 0.5) * static_cast<double>(width) / kGridSize;
      sample(3) = (j + 0.5) * static_cast<double>(height) / kGridSize;
      source.Unproject(source_params.data(), sample(2), sample(3), &sample(0));
      if (!sample.allFinite()) {
        throw InputError("Camera model " + source.Name() +
                         " has parameters that cannot be inverted within its "
                         "image, so it cannot be converted to " +
                         target.Name() + ".");
      }
      // Iterative undistortion is approximate: take the pixel of the ray.
      source.Project(source_params.data(), sample(0), sample(1), &sample(2));
    }
  }

  // Levenberg-Marquardt.
  double damping = 1e-6;
  double previous_cost = std::numeric_limits<double>::infinity();
  std::vector<double> best_params = params;
  Eigen::MatrixXd jacobian(num_rows, num_params);
  Eigen::VectorXd residuals(num_rows);
  Eigen::MatrixXd best_jacobian;
  Eigen::VectorXd best_residuals;
  for (int iteration = 0; iteration < kMaxNumIterations; ++iteration) {
    for (Eigen::Index i = 0; i < samples.cols(); ++i) {
      double xy[2];
      double jacobian_uv[4];
      Eigen::Matrix<double, 2, Eigen::Dynamic, Eigen::RowMajor> rows(
          2, num_params);
      target.ProjectWithJacobian(params.data(),
                                 samples(0, i),
                                 samples(1, i),
                                 xy,
                                 jacobian_uv,
                                 rows.data());
      jacobian.middleRows(2 * i, 2) = rows;
      residuals(2 * i) = xy[0] - samples(2, i);
      residuals(2 * i + 1) = xy[1] - samples(3, i);
    }
    const double cost = residuals.squaredNorm();
    if (cost < previous_cost) {
      const bool converged = previous_cost - cost <= kTolerance * cost;
      previous_cost = cost;
      best_params = params;
      best_jacobian = jacobian;
      best_residuals = residuals;
      damping *= 0.1;
      if (converged || cost < kTolerance) break;
    } else {
      damping = std::max(10.0 * damping, 1e-6);
      if (damping > 1e6) break;
    }
    if (!best_jacobian.size()) break;  // The start itself does not project.
    Eigen::MatrixXd hessian = best_jacobian.transpose() * best_jacobian;
    hessian.diagonal() *= 1.0 + damping;
    const Eigen::VectorXd step =
        hessian.ldlt().solve(best_jacobian.transpose() * best_residuals);
    for (Eigen::Index i = 0; i < num_params; ++i) {
      params[i] = best_params[i] - step(i);
    }
  }
  return best_params;
}

}  // namespace mfir
