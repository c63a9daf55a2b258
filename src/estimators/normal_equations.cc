#include "src/estimators/normal_equations.h"

#include <Eigen/Cholesky>

namespace mfir {

bool ComputeStep(const NormalEquations& equations,
                 double damping,
                 Eigen::VectorXd* step) {
  // Unit diagonal: parameters of different units become comparable.
  const Eigen::VectorXd diagonal = equations.hessian.diagonal();
  const double max_diagonal = diagonal.maxCoeff();
  if (!(max_diagonal > 0.0) || !diagonal.allFinite()) {
    return false;
  }
  const Eigen::VectorXd scale =
      diagonal.cwiseMax(1e-28 * max_diagonal).cwiseSqrt().cwiseInverse();
  Eigen::MatrixXd scaled =
      scale.asDiagonal() *
      equations.hessian.selfadjointView<Eigen::Lower>().toDenseMatrix() *
      scale.asDiagonal();
  scaled.diagonal().array() += damping >= kMinDamping ? damping : 0.0;
  const Eigen::LLT<Eigen::MatrixXd> factorization(scaled);
  if (factorization.info() != Eigen::Success) {
    return false;
  }
  *step = -(scale.asDiagonal() *
            factorization.solve(scale.asDiagonal() * equations.gradient));
  return step->allFinite();
}

bool SandwichCovariance(const Eigen::MatrixXd& hessian,
                        const Eigen::MatrixXd& gradient_outer,
                        Eigen::MatrixXd* covariance) {
  const Eigen::VectorXd scale =
      hessian.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  const Eigen::MatrixXd scaled_hessian =
      scale.asDiagonal() *
      hessian.selfadjointView<Eigen::Lower>().toDenseMatrix() *
      scale.asDiagonal();
  const Eigen::LLT<Eigen::MatrixXd> factorization(scaled_hessian);
  if (factorization.info() != Eigen::Success) return false;
  const Eigen::MatrixXd outer = gradient_outer.selfadjointView<Eigen::Lower>();
  const Eigen::MatrixXd half =
      factorization.solve(scale.asDiagonal() * outer * scale.asDiagonal());
  *covariance = scale.asDiagonal() * factorization.solve(half.transpose()) *
                scale.asDiagonal();
  return true;
}

Eigen::MatrixXd IntrinsicsCovariance(const std::vector<FreeParam>& params,
                                     const std::vector<RigCamera>& cameras,
                                     const Eigen::MatrixXd& free_covariance) {
  const Eigen::Index num_params = static_cast<Eigen::Index>(params.size());
  std::vector<Eigen::Index> camera_begins;
  Eigen::Index num_intrinsics = 0;
  for (const RigCamera& camera : cameras) {
    camera_begins.push_back(num_intrinsics);
    num_intrinsics += static_cast<Eigen::Index>(camera.params.size());
  }
  std::vector<Eigen::Index> targets;
  for (const FreeParam& param : params) {
    targets.push_back(param.IsPose()
                          ? -1
                          : camera_begins[param.camera_idx] +
                                static_cast<Eigen::Index>(param.idx));
  }
  Eigen::MatrixXd covariance =
      Eigen::MatrixXd::Zero(num_intrinsics, num_intrinsics);
  for (Eigen::Index i = 0; i < num_params; ++i) {
    for (Eigen::Index j = 0; j < num_params; ++j) {
      if (targets[i] < 0 || targets[j] < 0) continue;
      covariance(targets[i], targets[j]) = free_covariance(i, j);
    }
  }
  return covariance;
}

}  // namespace mfir
