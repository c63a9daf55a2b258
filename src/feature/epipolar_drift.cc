#include "src/feature/epipolar_drift.h"

#include <algorithm>
#include <array>
#include <cmath>

#include <Eigen/Cholesky>

#include "src/geometry/epipolar_tolerance.h"

namespace mfir {
namespace {

constexpr int kNumParams = 4;  // shift, scale, radial
// Standard deviations of the priors: of shifts relative to half the image
// diagonal, of scale and radial.
constexpr double kPriorStd = 0.05;
// Of the errors, pixels: keypoints are not better than this.
constexpr double kMinErrorScale = 0.5;
constexpr int kNumIterations = 8;

using Derivative = Eigen::Matrix<double, 1, kNumParams>;

double HalfDiagonal(const RigCamera& camera) {
  return 0.5 * std::hypot(camera.width, camera.height);
}

Eigen::Vector2d OffsetFromCenter(const RigCamera& camera,
                                 const Eigen::Vector2d& xy) {
  return xy - 0.5 * Eigen::Vector2d(camera.width, camera.height);
}

Eigen::Vector3d RayOf(const RigCamera& camera, const Eigen::Vector2d& xy) {
  Eigen::Vector2d uv;
  camera.model->Unproject(camera.params.data(), xy.x(), xy.y(), uv.data());
  return uv.homogeneous().normalized();
}

// Of the ray by the pixel coordinates.
Eigen::Matrix<double, 3, 2> RayDerivative(const RigCamera& camera,
                                          const Eigen::Vector2d& xy) {
  Eigen::Matrix<double, 3, 2> derivative;
  for (int axis = 0; axis < 2; ++axis) {
    const Eigen::Vector2d step = 0.5 * Eigen::Vector2d::Unit(axis);
    derivative.col(axis) = RayOf(camera, xy + step) - RayOf(camera, xy - step);
  }
  return derivative;
}

// The signed error of a match and its derivatives by the drift, in units of the
// priors' standard deviations, of both cameras.
struct Equation {
  size_t camera_idx1;
  size_t camera_idx2;
  double error;
  Derivative by_drift1;
  Derivative by_drift2;
};

Derivative ByDrift(const RigCamera& camera,
                   const Eigen::Vector2d& xy,
                   const Eigen::RowVector2d& by_xy) {
  const Eigen::Vector2d offset = OffsetFromCenter(camera, xy);
  const double half_diagonal = HalfDiagonal(camera);
  const double along = by_xy * offset;
  Derivative derivative;
  derivative << half_diagonal * by_xy, along,
      along * offset.squaredNorm() / (half_diagonal * half_diagonal);
  return kPriorStd * derivative;
}

double MeanFocalLength(const RigCamera& camera) {
  double sum = 0.0;
  const auto& idxs = camera.model->FocalLengthIdxs();
  for (const size_t idx : idxs) sum += camera.params[idx];
  return sum / static_cast<double>(idxs.size());
}

Equation MakeEquation(const RigCamera& camera1,
                      const RigCamera& camera2,
                      const EpipolarMatch& match) {
  const Eigen::Matrix3d E =
      EssentialMatrix(camera1.cam_from_world, camera2.cam_from_world);
  const Eigen::Vector3d ray1 = RayOf(camera1, match.xy1);
  const Eigen::Vector3d ray2 = RayOf(camera2, match.xy2);
  const double value = ray2.dot(E * ray1);
  // The denominator of the error hardly changes: its size is enough.
  const double error = EpipolarError(
      E, ray1, ray2, MeanFocalLength(camera1), MeanFocalLength(camera2));
  const double factor = error / std::max(std::abs(value), 1e-12);
  return {match.camera_idx1,
          match.camera_idx2,
          factor * value,
          ByDrift(camera1,
                  match.xy1,
                  factor * ray2.transpose() * E *
                      RayDerivative(camera1, match.xy1)),
          ByDrift(camera2,
                  match.xy2,
                  factor * (E * ray1).transpose() *
                      RayDerivative(camera2, match.xy2))};
}

double ErrorAt(const Eigen::VectorXd& drift, const Equation& equation) {
  return equation.error +
         equation.by_drift1.dot(
             drift.segment<kNumParams>(kNumParams * equation.camera_idx1)) +
         equation.by_drift2.dot(
             drift.segment<kNumParams>(kNumParams * equation.camera_idx2));
}

// Robust standard deviation of the errors.
double ErrorScale(std::vector<double> abs_errors) {
  const auto middle = abs_errors.begin() + abs_errors.size() / 2;
  std::nth_element(abs_errors.begin(), middle, abs_errors.end());
  return std::max(1.4826 * *middle, kMinErrorScale);
}

// One step of iteratively reweighted least squares with Cauchy's loss.
Eigen::VectorXd Improve(const std::vector<Equation>& equations,
                        const Eigen::VectorXd& drift) {
  std::vector<double> abs_errors;
  for (const Equation& equation : equations) {
    abs_errors.push_back(std::abs(ErrorAt(drift, equation)));
  }
  const double scale = ErrorScale(abs_errors);
  Eigen::MatrixXd matrix =
      Eigen::MatrixXd::Identity(drift.size(), drift.size());
  Eigen::VectorXd rhs = Eigen::VectorXd::Zero(drift.size());
  for (size_t i = 0; i < equations.size(); ++i) {
    const Equation& equation = equations[i];
    const double ratio = abs_errors[i] / scale;
    const double weight = 1.0 / (scale * scale * (1.0 + ratio * ratio));
    const Eigen::Index begin1 = kNumParams * equation.camera_idx1;
    const Eigen::Index begin2 = kNumParams * equation.camera_idx2;
    const Derivative& a1 = equation.by_drift1;
    const Derivative& a2 = equation.by_drift2;
    matrix.block<kNumParams, kNumParams>(begin1, begin1) +=
        weight * a1.transpose() * a1;
    matrix.block<kNumParams, kNumParams>(begin2, begin2) +=
        weight * a2.transpose() * a2;
    matrix.block<kNumParams, kNumParams>(begin1, begin2) +=
        weight * a1.transpose() * a2;
    matrix.block<kNumParams, kNumParams>(begin2, begin1) +=
        weight * a2.transpose() * a1;
    rhs.segment<kNumParams>(begin1) -= weight * equation.error * a1.transpose();
    rhs.segment<kNumParams>(begin2) -= weight * equation.error * a2.transpose();
  }
  return matrix.llt().solve(rhs);
}

}  // namespace

Eigen::Vector2d PixelDrift::Correct(const RigCamera& camera,
                                    const Eigen::Vector2d& xy) const {
  const Eigen::Vector2d offset = OffsetFromCenter(camera, xy);
  const double half_diagonal = HalfDiagonal(camera);
  return xy + shift +
         (scale +
          radial * offset.squaredNorm() / (half_diagonal * half_diagonal)) *
             offset;
}

std::vector<PixelDrift> EstimateEpipolarDrift(
    const std::vector<RigCamera>& cameras,
    const std::vector<EpipolarMatch>& matches) {
  std::vector<Equation> equations;
  for (const EpipolarMatch& match : matches) {
    const Equation equation = MakeEquation(
        cameras[match.camera_idx1], cameras[match.camera_idx2], match);
    if (std::isfinite(equation.error) && equation.by_drift1.allFinite() &&
        equation.by_drift2.allFinite()) {
      equations.push_back(equation);
    }
  }
  std::vector<PixelDrift> drifts(cameras.size());
  if (equations.empty()) return drifts;
  Eigen::VectorXd drift = Eigen::VectorXd::Zero(kNumParams * cameras.size());
  for (int i = 0; i < kNumIterations; ++i) drift = Improve(equations, drift);
  for (size_t i = 0; i < cameras.size(); ++i) {
    const Eigen::Vector4d params =
        kPriorStd * drift.segment<kNumParams>(kNumParams * i);
    if (cameras[i].width == 0) continue;
    drifts[i].shift = HalfDiagonal(cameras[i]) * params.head<2>();
    drifts[i].scale = params(2);
    drifts[i].radial = params(3);
  }
  return drifts;
}

}  // namespace mfir
