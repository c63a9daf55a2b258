// One observation under a camera with known pose: residual and derivatives.

#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

#include <Eigen/Core>

#include "src/scene/scene.h"
#include "src/sensor/camera_model.h"

namespace mfir {

// Of COLMAP's camera models (RAD_TAN_THIN_PRISM_FISHEYE of COLMAP 4), and with
// a pose correction.
constexpr size_t kMaxNumIntrinsics = 16;
constexpr size_t kNumPoseParams = 6;
constexpr size_t kMaxNumParams = kMaxNumIntrinsics + kNumPoseParams;

using Matrix2x3 = Eigen::Matrix<double, 2, 3>;

// x_cam = rotation * x_world + translation.
struct CameraState {
  Eigen::Matrix3d rotation;
  Eigen::Vector3d translation;
  std::vector<double> params;
  // About the largest |(u, v)| in the image.
  double max_radius = 0.0;
};

inline double MaxImageRadius(const RigCamera& camera) {
  double max_radius = 0.0;
  for (const double x : {0.0, static_cast<double>(camera.width)}) {
    for (const double y : {0.0, static_cast<double>(camera.height)}) {
      double uv[2];
      camera.model->Unproject(camera.params.data(), x, y, uv);
      max_radius = std::max(max_radius, std::hypot(uv[0], uv[1]));
    }
  }
  return max_radius;
}

inline std::vector<CameraState> CameraStates(
    const std::vector<RigCamera>& cameras) {
  std::vector<CameraState> states;
  for (const RigCamera& camera : cameras) {
    states.push_back({camera.cam_from_world.rotation.toRotationMatrix(),
                      camera.cam_from_world.translation,
                      camera.params,
                      camera.model == nullptr ? 0.0 : MaxImageRadius(camera)});
  }
  return states;
}

// Which parameters of a camera are free, in the order of the Jacobian's
// columns: intrinsics by index, then, with `pose`, a rotation (rad, applied
// after the present one) and a shift of the camera centre (world units).
struct FreeParams {
  std::vector<size_t> intrinsics_idxs;
  bool pose = false;

  size_t Size() const {
    return intrinsics_idxs.size() + (pose ? kNumPoseParams : 0);
  }
};

struct Linearization {
  Eigen::Vector2d residual;  // px
  double depth;              // world units
  Eigen::Vector2d uv;        // point / depth, camera coordinates
  Matrix2x3 jacobian_point;
  Eigen::Matrix<double, 2, Eigen::Dynamic, Eigen::RowMajor, 2, kMaxNumParams>
      jacobian_params;
};

// False for a point behind the camera.
inline bool ProjectPoint(const CameraModel& model,
                         const CameraState& state,
                         const Eigen::Vector3d& xyz,
                         Eigen::Vector2d* xy) {
  const Eigen::Vector3d p = state.rotation * xyz + state.translation;
  if (!(p.z() > std::numeric_limits<double>::epsilon())) {
    return false;
  }
  model.Project(state.params.data(), p.x() / p.z(), p.y() / p.z(), xy->data());
  return xy->allFinite();
}

// False for a point behind the camera.
inline bool LinearizeObservation(const CameraModel& model,
                                 const CameraState& state,
                                 const FreeParams& free_params,
                                 const Eigen::Vector2d& observed_xy,
                                 const Eigen::Vector3d& xyz,
                                 Linearization* linearization) {
  const Eigen::Vector3d p = state.rotation * xyz + state.translation;
  if (!(p.z() > std::numeric_limits<double>::epsilon())) {
    return false;
  }
  const double inverse_depth = 1.0 / p.z();
  const double u = p.x() * inverse_depth;
  const double v = p.y() * inverse_depth;

  Eigen::Vector2d xy;
  Eigen::Matrix<double, 2, 2, Eigen::RowMajor> jacobian_uv;
  double jacobian_intrinsics[2 * kMaxNumIntrinsics];
  model.ProjectWithJacobian(state.params.data(),
                            u,
                            v,
                            xy.data(),
                            jacobian_uv.data(),
                            jacobian_intrinsics);
  linearization->residual = xy - observed_xy;
  linearization->depth = p.z();
  linearization->uv = Eigen::Vector2d(u, v);
  // d(u, v) / d(p) = [1 0 -u; 0 1 -v] / z.
  Matrix2x3 jacobian_cam;
  jacobian_cam << jacobian_uv * inverse_depth,
      -jacobian_uv * Eigen::Vector2d(u, v) * inverse_depth;
  linearization->jacobian_point = jacobian_cam * state.rotation;

  auto& jacobian_params = linearization->jacobian_params;
  jacobian_params.resize(2, free_params.Size());
  Eigen::Index column = 0;
  for (const size_t idx : free_params.intrinsics_idxs) {
    jacobian_params(0, column) = jacobian_intrinsics[idx];
    jacobian_params(1, column) = jacobian_intrinsics[model.NumParams() + idx];
    ++column;
  }
  if (free_params.pose) {
    // p = exp(w) R (X - C): dp/dw = -[p]_x, dp/dC = -R.
    for (int row = 0; row < 2; ++row) {
      const Eigen::Vector3d gradient = jacobian_cam.row(row);
      jacobian_params.row(row).segment<3>(column) =
          p.cross(gradient).transpose();
      jacobian_params.row(row).segment<3>(column + 3) =
          -linearization->jacobian_point.row(row);
    }
  }
  return linearization->residual.allFinite();
}

}  // namespace mfir
