// Robust loss estimated from the data.

#pragma once

#include <ceres/loss_function.h>

#include "src/residuals/noise_samples.h"

#include <vector>

namespace mfir {

// Gaussian part of a distribution of noise.
struct NoiseComponent {
  double std_px = 0.0;  // per axis
  double share = 0.0;
};

// Negative log-likelihood of 2D residuals r under a mixture of isotropic
// Gaussians,
//
//   p(r) = sum_k pi_k / (2 pi sigma_k^2) exp(-|r|^2 / (2 sigma_k^2)),
//   rho(s) = 2 log p(0) - 2 log p(sqrt(s)),   s = |r|^2 in px^2,
//
// with fixed sigma_k, a factor sqrt(2) apart, and mixture weights pi_k fitted
// by expectation maximization. Any heavy-tailed symmetric noise is close to
// such a mixture, so that neither the scale nor the shape of the loss has to be
// chosen: it is quadratic for clean Gaussian noise and redescends quickly where
// there are outliers. With gamma_k the posterior of the components at s:
//
//   rho'  = E_gamma[1 / sigma^2],   rho'' = -1/2 Var_gamma[1 / sigma^2].
//
// cost = sum 1/2 rho is in units of the noise: its Hessian is an information.
class ScaleMixtureLoss final : public ceres::LossFunction {
 public:
  // Fits the mixture to the samples of all ranks. Needs at least one.
  explicit ScaleMixtureLoss(const std::vector<NoiseSample>& samples,
                            const Communicator& ranks = Alone(),
                            int num_threads = 1);

  // rho[0..2] = rho(s), rho'(s), rho''(s).
  void Evaluate(double s, double rho[3]) const override;

  // Standard deviation (px per axis) of the noise where the residuals are
  // dense: sigma that a Gaussian with the same rho'(0) has.
  double CoreStd() const;

  // The same for all components but outliers: root of their mean variance.
  double InlierStd() const;

  // The components with a share above 1e-6, narrow ones first.
  std::vector<NoiseComponent> Components() const;

  // Share of the components wider than 4 times CoreStd: outliers.
  double OutlierShare() const;

 private:
  struct Component {
    double information;  // 1 / sigma^2
    double density;      // pi / sigma^2: at 0, up to a constant
    double log_density;
    double share;  // pi
    // Whether the next one has twice the variance.
    bool next_is_double;
  };

  // For any s.
  void EvaluateFarOut(double s, double rho[3]) const;

  double MinInlierInformation() const;

  std::vector<Component> components_;
  double log_density_at_zero_ = 0.0;
};

}  // namespace mfir
