#include "src/report/camera_maps.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <Eigen/Eigenvalues>

namespace mfir {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

// Root mean square of some of the values.
double RootMeanSquare(const std::vector<double>& values,
                      const std::vector<size_t>& idxs) {
  double sum = 0.0;
  for (const size_t idx : idxs) {
    sum += idx < values.size() ? values[idx] * values[idx] : kNaN;
  }
  return std::sqrt(sum / static_cast<double>(idxs.size()));
}

// Pixels beyond which a polynomial is no lens any more.
constexpr double kMaxDisplacement = 1e4;

}  // namespace

std::vector<Eigen::Vector2d> GridPoints(size_t width,
                                        size_t height,
                                        int columns,
                                        int rows) {
  std::vector<Eigen::Vector2d> points;
  for (int row = 0; row < rows; ++row) {
    for (int column = 0; column < columns; ++column) {
      points.emplace_back((column + 0.5) / columns * static_cast<double>(width),
                          (row + 0.5) / rows * static_cast<double>(height));
    }
  }
  return points;
}

std::vector<Eigen::Vector2d> Displacements(
    const CameraValues& before,
    const CameraValues& after,
    const std::vector<Eigen::Vector2d>& pixels) {
  const Eigen::Vector2d center = ToPinhole(before).principal_point;
  std::vector<Eigen::Vector2d> displacements;
  for (const Eigen::Vector2d& pixel : pixels) {
    Eigen::Vector2d uv(kNaN, kNaN);
    Eigen::Vector2d again(kNaN, kNaN);
    Eigen::Vector2d moved(kNaN, kNaN);
    before.model->Unproject(
        before.params.data(), pixel.x(), pixel.y(), uv.data());
    before.model->Project(before.params.data(), uv.x(), uv.y(), again.data());
    after.model->Project(after.params.data(), uv.x(), uv.y(), moved.data());
    const Eigen::Vector2d displacement = moved - pixel;
    // A ray that is not the pixel's tells nothing, nor does one that a
    // polynomial has folded over from the other side.
    const bool is_ray =
        (again - pixel).norm() < 0.01 && uv.dot(pixel - center) >= 0.0;
    displacements.push_back(is_ray && displacement.norm() < kMaxDisplacement
                                ? displacement
                                : Eigen::Vector2d(kNaN, kNaN));
  }
  return displacements;
}

std::vector<double> ProjectionStds(const ReportCamera& camera,
                                   const std::vector<Eigen::Vector2d>& pixels) {
  std::vector<double> stds;
  const auto num_params = static_cast<Eigen::Index>(camera.params.size());
  for (const Eigen::Vector2d& pixel : pixels) {
    Eigen::Vector2d uv(kNaN, kNaN);
    Eigen::Vector2d xy;
    Eigen::Matrix<double, 2, 2, Eigen::RowMajor> jacobian_uv;
    Eigen::Matrix<double, 2, Eigen::Dynamic, Eigen::RowMajor> jacobian(
        2, num_params);
    camera.model->Unproject(
        camera.params.data(), pixel.x(), pixel.y(), uv.data());
    camera.model->ProjectWithJacobian(camera.params.data(),
                                      uv.x(),
                                      uv.y(),
                                      xy.data(),
                                      jacobian_uv.data(),
                                      jacobian.data());
    const Eigen::Matrix2d covariance =
        jacobian * camera.covariance * jacobian.transpose();
    if (!covariance.allFinite()) {
      stds.push_back(kNaN);
      continue;
    }
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> solver(
        covariance, Eigen::EigenvaluesOnly);
    stds.push_back(std::sqrt(std::max(0.0, solver.eigenvalues()(1))));
  }
  return stds;
}

std::vector<Eigen::Vector2d> DistortionCurve(const CameraValues& camera,
                                             size_t width,
                                             size_t height) {
  constexpr int kNumSteps = 24;
  const PinholeValues pinhole = ToPinhole(camera);
  const bool is_fisheye =
      camera.model->Name().find("FISHEYE") != std::string::npos;
  Eigen::Vector2d corner(0.0, 0.0);
  for (const double x : {0.0, static_cast<double>(width)}) {
    for (const double y : {0.0, static_cast<double>(height)}) {
      const Eigen::Vector2d candidate =
          Eigen::Vector2d(x, y) - pinhole.principal_point;
      if (candidate.norm() > corner.norm()) corner = candidate;
    }
  }
  std::vector<Eigen::Vector2d> curve;
  for (int i = 0; i <= kNumSteps; ++i) {
    const Eigen::Vector2d offset = corner * i / kNumSteps;
    const Eigen::Vector2d pixel = pinhole.principal_point + offset;
    Eigen::Vector2d uv(kNaN, kNaN);
    Eigen::Vector2d again(kNaN, kNaN);
    camera.model->Unproject(
        camera.params.data(), pixel.x(), pixel.y(), uv.data());
    camera.model->Project(camera.params.data(), uv.x(), uv.y(), again.data());
    if (!((again - pixel).norm() < 0.01)) continue;
    const double tangent = uv.norm();
    curve.emplace_back(
        offset.norm(),
        offset.norm() -
            pinhole.focal_length * (is_fisheye ? std::atan(tangent) : tangent));
  }
  return curve;
}

PinholeValues ToPinhole(const CameraValues& camera) {
  PinholeValues values;
  const std::vector<size_t>& focal_idxs = camera.model->FocalLengthIdxs();
  for (const size_t idx : focal_idxs) {
    values.focal_length +=
        camera.params[idx] / static_cast<double>(focal_idxs.size());
  }
  const std::vector<size_t>& idxs = camera.model->PrincipalPointIdxs();
  values.principal_point = {camera.params[idxs[0]], camera.params[idxs[1]]};
  return values;
}

PinholeStds ToPinholeStds(const CameraValues& camera) {
  return {
      RootMeanSquare(camera.params_std, camera.model->FocalLengthIdxs()),
      RootMeanSquare(camera.params_std, camera.model->PrincipalPointIdxs())};
}

CameraValues Values(const ReportCamera& camera) {
  return {camera.model, camera.params, camera.params_std};
}

}  // namespace mfir
