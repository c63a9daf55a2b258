// The featuremetric term (eq. "featuremetric reprojection with cost map" of the
// paper): the cost map of an observation at the projection of its point.

#pragma once

#include <cmath>
#include <memory>
#include <utility>

#include <ceres/cost_function.h>
#include <Eigen/Core>

#include "src/geometry/cubic_interpolation.h"
#include "src/residuals/linearization.h"
#include "src/scene/scene.h"
#include "src/sensor/camera_model.h"

namespace mfir {

using Matrix3x2 = Eigen::Matrix<double, 3, 2>;

// Residual r = G(xy), the 3 channels of cost map `idx` by bicubic
// interpolation, and, unless null, its derivatives by `xy` (image
// coordinates). Outside of the patch (cubic_interpolation.h) r is constant and
// continuous, its derivative zero: a projection that is too far off for the
// feature is not moved by it. NaN counts as outside.
inline void EvaluateFeaturemetric(const CostMaps& cost_maps,
                                  size_t idx,
                                  const Eigen::Vector2d& xy,
                                  Eigen::Vector3d* residual,
                                  Matrix3x2* jacobian) {
  const int size = cost_maps.patch_size;
  const CostMaps::Placement& placement = cost_maps.placements[idx];
  const Eigen::Vector2d position =
      (xy - placement.origin) / placement.pixel_size;
  const CubicWeights columns = MakeCubicWeights(position.x(), size);
  const CubicWeights rows = MakeCubicWeights(position.y(), size);
  const uint16_t* map = cost_maps.Data(idx);
  residual->setZero();
  Matrix3x2 derivative = Matrix3x2::Zero();
  for (int i = 0; i < 4; ++i) {
    const uint16_t* element =
        map + ((rows.begin + i) * size + columns.begin) * 3;
    Eigen::Vector3d value = Eigen::Vector3d::Zero();
    Eigen::Vector3d value_dx = Eigen::Vector3d::Zero();
    for (int j = 0; j < 4; ++j) {
      const Eigen::Vector3d sample(HalfToFloat(element[3 * j]),
                                   HalfToFloat(element[3 * j + 1]),
                                   HalfToFloat(element[3 * j + 2]));
      value += columns.weight[j] * sample;
      value_dx += columns.derivative[j] * sample;
    }
    *residual += rows.weight[i] * value;
    derivative.col(0) += rows.weight[i] * value_dx;
    derivative.col(1) += rows.derivative[i] * value;
  }
  if (jacobian != nullptr) *jacobian = derivative / placement.pixel_size;
}

// The same as a function of the variables of a bundle adjustment. Blocks:
// rotation (w, x, y, z) and translation of cam_from_world, point, intrinsics,
// like COLMAP's reprojection residuals.
class FeaturemetricCost : public ceres::CostFunction {
 public:
  FeaturemetricCost(const CameraModel* model,
                    std::shared_ptr<const CostMaps> cost_maps,
                    size_t cost_map_idx)
      : model_(model),
        cost_maps_(std::move(cost_maps)),
        cost_map_idx_(cost_map_idx) {
    set_num_residuals(3);
    *mutable_parameter_block_sizes() = {
        4, 3, 3, static_cast<int32_t>(model->NumParams())};
  }

  bool Evaluate(double const* const* parameters,
                double* residuals,
                double** jacobians) const override {
    const double w = parameters[0][0];
    const Eigen::Map<const Eigen::Vector3d> v(parameters[0] + 1);
    const Eigen::Map<const Eigen::Vector3d> translation(parameters[1]);
    const Eigen::Map<const Eigen::Vector3d> xyz(parameters[2]);
    // Of a unit quaternion, as in ceres::UnitQuaternionRotatePoint.
    const Eigen::Vector3d cross = v.cross(xyz);
    const Eigen::Vector3d p =
        xyz + 2.0 * (w * cross + v.cross(cross)) + translation;
    const Eigen::Vector2d uv = p.head<2>() / p.z();
    const Eigen::Index num_params =
        static_cast<Eigen::Index>(model_->NumParams());

    Eigen::Vector2d xy;
    Eigen::Matrix<double, 2, 2, Eigen::RowMajor> xy_from_uv;
    Eigen::Matrix<double, 2, Eigen::Dynamic, Eigen::RowMajor, 2, kMaxNumParams>
        xy_from_params(2, num_params);
    if (jacobians == nullptr) {
      model_->Project(parameters[3], uv.x(), uv.y(), xy.data());
    } else {
      model_->ProjectWithJacobian(parameters[3],
                                  uv.x(),
                                  uv.y(),
                                  xy.data(),
                                  xy_from_uv.data(),
                                  xy_from_params.data());
    }
    Eigen::Vector3d residual;
    Matrix3x2 from_xy;
    EvaluateFeaturemetric(*cost_maps_, cost_map_idx_, xy, &residual, &from_xy);
    Eigen::Map<Eigen::Vector3d>(residuals, 3) = residual;
    if (jacobians == nullptr) return true;

    // d(u, v) / d(p) = [1 0 -u; 0 1 -v] / z.
    Eigen::Matrix3d from_cam;
    from_cam << from_xy * xy_from_uv, -from_xy * (xy_from_uv * uv);
    from_cam /= p.z();
    if (from_xy.isZero(0.0)) {
      // Outside, even where the projection itself has no derivative.
      from_cam.setZero();
      xy_from_params.setZero();
    }
    if (jacobians[0] != nullptr) {
      Eigen::Map<Eigen::Matrix<double, 3, 4, Eigen::RowMajor>> from_rotation(
          jacobians[0]);
      Eigen::Matrix3d p_from_v =
          2.0 * (v * xyz.transpose() - 2.0 * xyz * v.transpose() -
                 w * CrossMatrix(xyz));
      p_from_v.diagonal().array() += 2.0 * v.dot(xyz);
      from_rotation << from_cam * (2.0 * cross), from_cam * p_from_v;
    }
    using RowMajor3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
    if (jacobians[1] != nullptr) {
      Eigen::Map<RowMajor3> from_translation(jacobians[1]);
      from_translation = from_cam;
    }
    if (jacobians[2] != nullptr) {
      Eigen::Map<RowMajor3> from_point(jacobians[2]);
      from_point =
          from_cam *
          Eigen::Quaterniond(w, v.x(), v.y(), v.z()).toRotationMatrix();
    }
    if (jacobians[3] != nullptr) {
      Eigen::Map<Eigen::Matrix<double, 3, Eigen::Dynamic, Eigen::RowMajor>>
          from_params(jacobians[3], 3, num_params);
      from_params = from_xy * xy_from_params;
    }
    return true;
  }

 private:
  static Eigen::Matrix3d CrossMatrix(const Eigen::Vector3d& a) {
    Eigen::Matrix3d matrix;
    matrix << 0.0, -a.z(), a.y(), a.z(), 0.0, -a.x(), -a.y(), a.x(), 0.0;
    return matrix;
  }

  const CameraModel* model_;
  const std::shared_ptr<const CostMaps> cost_maps_;
  const size_t cost_map_idx_;
};

}  // namespace mfir
