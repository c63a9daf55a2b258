// Residuals of the prior and variance terms.

#pragma once

#include <cstddef>
#include <utility>
#include <vector>

#include <ceres/autodiff_cost_function.h>
#include <ceres/cost_function.h>
#include <ceres/dynamic_autodiff_cost_function.h>
#include <ceres/rotation.h>
#include <Eigen/Core>
#include <Eigen/Geometry>

namespace mfir {

// Extrinsics prior on the rotation (first term of eq. 3):
//
//   r = log(R Rhat^T)   [rad, 3-vector]
//
// with R the estimated and Rhat the known cam_from_world rotation. The norm is
// the angle between the two; unlike the paper's difference of angle-axis
// vectors it does not jump where an angle passes pi. `qvec` is (w, x, y, z).
class RotationPriorCost {
 public:
  explicit RotationPriorCost(const Eigen::Quaterniond& known_cam_from_world) {
    const Eigen::Quaterniond inverse = known_cam_from_world.conjugate();
    inverse_known_[0] = inverse.w();
    inverse_known_[1] = inverse.x();
    inverse_known_[2] = inverse.y();
    inverse_known_[3] = inverse.z();
  }

  static ceres::CostFunction* Create(
      const Eigen::Quaterniond& known_cam_from_world) {
    return new ceres::AutoDiffCostFunction<RotationPriorCost, 3, 4>(
        new RotationPriorCost(known_cam_from_world));
  }

  template <typename T>
  bool operator()(const T* const qvec, T* residuals) const {
    const T inverse_known[4] = {T(inverse_known_[0]),
                                T(inverse_known_[1]),
                                T(inverse_known_[2]),
                                T(inverse_known_[3])};
    T difference[4];
    ceres::QuaternionProduct(qvec, inverse_known, difference);
    ceres::QuaternionToAngleAxis(difference, residuals);
    return true;
  }

 private:
  double inverse_known_[4];
};

// Extrinsics prior on the translation (second term of eq. 3):
//
//   r = t - that   [world units, 3-vector], t = cam_from_world translation.
class TranslationPriorCost {
 public:
  explicit TranslationPriorCost(const Eigen::Vector3d& known_translation)
      : known_translation_(known_translation) {}

  static ceres::CostFunction* Create(const Eigen::Vector3d& known_translation) {
    return new ceres::AutoDiffCostFunction<TranslationPriorCost, 3, 3>(
        new TranslationPriorCost(known_translation));
  }

  template <typename T>
  bool operator()(const T* const tvec, T* residuals) const {
    for (int i = 0; i < 3; ++i) {
      residuals[i] = tvec[i] - known_translation_(i);
    }
    return true;
  }

 private:
  const Eigen::Vector3d known_translation_;
};

// Intrinsics variance (eq. 9) of one group of parameters (focal length,
// principal point or distortion):
//
//   r_k = scale_k (K_ij[idx_k] - Kbar_j[idx_k])   [px]
//
// with K_ij the intrinsics of frame i and camera j and Kbar_j the global ones.
// scale is 1 for focal length and principal point; for distortion it turns a
// coefficient into the pixels it moves the image corner by.
class IntrinsicsVarianceCost {
 public:
  // (index into the parameter vector, scale)
  using Terms = std::vector<std::pair<size_t, double>>;

  explicit IntrinsicsVarianceCost(Terms terms) : terms_(std::move(terms)) {}

  static ceres::CostFunction* Create(size_t num_params, const Terms& terms) {
    auto* cost = new ceres::DynamicAutoDiffCostFunction<IntrinsicsVarianceCost>(
        new IntrinsicsVarianceCost(terms));
    cost->AddParameterBlock(static_cast<int>(num_params));
    cost->AddParameterBlock(static_cast<int>(num_params));
    cost->SetNumResiduals(static_cast<int>(terms.size()));
    return cost;
  }

  template <typename T>
  bool operator()(T const* const* params, T* residuals) const {
    for (size_t i = 0; i < terms_.size(); ++i) {
      const size_t idx = terms_[i].first;
      residuals[i] = terms_[i].second * (params[0][idx] - params[1][idx]);
    }
    return true;
  }

 private:
  const Terms terms_;
};

}  // namespace mfir
