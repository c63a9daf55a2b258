#include "src/patches/point_fit.h"

#include <Eigen/Cholesky>

namespace mfir {
namespace {

constexpr int kMaxNumPointIterations = 5;
// By which a point may move, relative to its distance from the first camera:
// rays that are nearly parallel say little about it.
constexpr double kMaxPointMove = 0.05;
constexpr double kPointLossScale = 0.5;  // px

// Residual of a point and its derivative; false behind the camera.
bool PointResidual(const PatchCamera& camera,
                   const Eigen::Vector3d& xyz,
                   const Eigen::Vector2d& xy,
                   std::vector<double>* scratch,
                   Eigen::Vector2d* residual,
                   Eigen::Matrix<double, 2, 3>* jacobian) {
  const Eigen::Vector3d p = camera.cam_from_world * xyz;
  if (!(p.z() > 0.0)) return false;
  const double u = p.x() / p.z();
  const double v = p.y() / p.z();
  scratch->resize(2 * camera.model->NumParams());
  Eigen::Vector2d projection;
  Eigen::Matrix<double, 2, 2, Eigen::RowMajor> lens;
  camera.model->ProjectWithJacobian(camera.params.data(),
                                    u,
                                    v,
                                    projection.data(),
                                    lens.data(),
                                    scratch->data());
  Eigen::Matrix<double, 2, 3> perspective;
  perspective << 1.0, 0.0, -u, 0.0, 1.0, -v;
  *residual = projection - xy;
  *jacobian = lens * perspective / p.z() *
              camera.cam_from_world.rotation.toRotationMatrix();
  return residual->allFinite() && jacobian->allFinite();
}

}  // namespace

Eigen::Vector3d FitPoint(const std::vector<PatchCamera>& cameras,
                         const std::vector<PointObservation>& observations,
                         const Eigen::Vector3d& start) {
  Eigen::Vector3d xyz = start;
  std::vector<double> scratch;
  for (int i = 0; i < kMaxNumPointIterations; ++i) {
    Eigen::Matrix3d hessian = Eigen::Matrix3d::Zero();
    Eigen::Vector3d gradient = Eigen::Vector3d::Zero();
    for (const PointObservation& observation : observations) {
      Eigen::Vector2d residual;
      Eigen::Matrix<double, 2, 3> jacobian;
      if (!PointResidual(cameras[observation.camera_idx],
                         xyz,
                         observation.xy,
                         &scratch,
                         &residual,
                         &jacobian)) {
        return start;
      }
      const double weight =
          1.0 /
          (1.0 + residual.squaredNorm() / (kPointLossScale * kPointLossScale));
      hessian += weight * jacobian.transpose() * jacobian;
      gradient += weight * jacobian.transpose() * residual;
    }
    const Eigen::Vector3d step = hessian.ldlt().solve(gradient);
    if (!step.allFinite()) return start;
    xyz -= step;
    if (step.dot(hessian * step) < 1e-6) break;
  }
  const double distance =
      (cameras[observations.front().camera_idx].cam_from_world * start).norm();
  return (xyz - start).norm() <= kMaxPointMove * distance ? xyz : start;
}

}  // namespace mfir
