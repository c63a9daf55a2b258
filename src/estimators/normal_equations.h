// The reduced system of the cameras.

#pragma once

#include <vector>

#include <Eigen/Core>

#include "src/estimators/free_params.h"
#include "src/scene/scene.h"

namespace mfir {

// Damping below this is off.
constexpr double kMinDamping = 1e-9;

// The normal equations of the cameras, hessian * step = -gradient (lower
// triangle only).
struct NormalEquations {
  Eigen::MatrixXd hessian;
  Eigen::VectorXd gradient;

  void SetZero(Eigen::Index size) {
    hessian.setZero(size, size);
    gradient.setZero(size);
  }
};

// Solves with `damping` added to the diagonal, scaled to 1. False if the system
// is not positive definite.
bool ComputeStep(const NormalEquations& equations,
                 double damping,
                 Eigen::VectorXd* step);

// H^-1 G H^-1 from the lower triangles of H and G. False if H is not positive
// definite.
bool SandwichCovariance(const Eigen::MatrixXd& hessian,
                        const Eigen::MatrixXd& gradient_outer,
                        Eigen::MatrixXd* covariance);

// From free parameters to all intrinsics, stacked by camera.
Eigen::MatrixXd IntrinsicsCovariance(const std::vector<FreeParam>& params,
                                     const std::vector<RigCamera>& cameras,
                                     const Eigen::MatrixXd& free_covariance);

}  // namespace mfir
