#include "src/residuals/scale_mixture_loss.h"

#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "src/util/random.h"

namespace mfir {
namespace {

// Coordinates of residuals: Gaussian noise with a share of wider ones.
std::vector<NoiseSample> ContaminatedSamples(size_t count,
                                             double sigma,
                                             double outlier_share,
                                             double outlier_sigma) {
  Random random({11});
  std::vector<NoiseSample> samples;
  for (size_t i = 0; i < count; ++i) {
    const bool outlier = random.Uniform() < outlier_share;
    const double residual = random.Normal(0.0, outlier ? outlier_sigma : sigma);
    samples.push_back({residual * residual, 1.0});
  }
  return samples;
}

// 0 and 1e-6 to 1e8 in steps of 10 %, px^2.
std::vector<double> SquaredNorms() {
  std::vector<double> squared_norms = {0.0};
  for (double s = 1e-6; s < 1.1e8; s *= 1.1) squared_norms.push_back(s);
  return squared_norms;
}

// rho(0) = 0, increasing, concave, and derivatives that are those of rho.
void ExpectValidLoss(const ScaleMixtureLoss& loss) {
  double previous[3] = {-1e-12, 0.0, 0.0};
  double at_zero[3];
  loss.Evaluate(0.0, at_zero);
  EXPECT_NEAR(at_zero[0], 0.0, 1e-12);
  EXPECT_GT(at_zero[1], 0.0);
  for (const double s : SquaredNorms()) {
    double rho[3];
    loss.Evaluate(s, rho);
    ASSERT_TRUE(std::isfinite(rho[0]) && std::isfinite(rho[1]) &&
                std::isfinite(rho[2]))
        << s;
    ASSERT_GE(rho[0], previous[0]) << s;
    ASSERT_GT(rho[1], 0.0) << s;
    ASSERT_LE(rho[1], at_zero[1] * (1.0 + 1e-12)) << s;
    ASSERT_LE(rho[2], 0.0) << s;
    if (s > 0.0) {
      const double step = 1e-4 * s;
      double plus[3];
      double minus[3];
      loss.Evaluate(s + step, plus);
      loss.Evaluate(s - step, minus);
      // Truncation (step / s)^2 times the curvature of log rho, and rounding
      // of rho over the step.
      ASSERT_NEAR((plus[0] - minus[0]) / (2.0 * step),
                  rho[1],
                  1e-5 * rho[1] + 1e-14 * (1.0 + rho[0]) / step)
          << s;
      ASSERT_NEAR((plus[1] - minus[1]) / (2.0 * step),
                  rho[2],
                  1e-4 * std::abs(rho[2]) + 1e-14 * rho[1] / step)
          << s;
    }
    std::copy(rho, rho + 3, previous);
  }
}

TEST(ScaleMixtureLoss, DerivativesAreThoseOfTheValue) {
  ExpectValidLoss(ScaleMixtureLoss(ContaminatedSamples(20000, 0.5, 0.1, 15)));
  ExpectValidLoss(ScaleMixtureLoss(ContaminatedSamples(20000, 0.5, 0.0, 15)));
  ExpectValidLoss(ScaleMixtureLoss(ContaminatedSamples(2000, 0.01, 0.4, 100)));
}

TEST(ScaleMixtureLoss, RecoversGaussianNoise) {
  for (const double sigma : {1e-3, 0.5, 20.0}) {
    const ScaleMixtureLoss loss(ContaminatedSamples(50000, sigma, 0.0, 1.0));
    EXPECT_NEAR(loss.CoreStd(), sigma, 0.06 * sigma);
    EXPECT_LT(loss.OutlierShare(), 0.002);
    // Close to quadratic out to 2.5 sigma.
    double rho[3];
    loss.Evaluate(std::pow(2.5 * sigma, 2), rho);
    EXPECT_NEAR(rho[1] * sigma * sigma, 1.0, 0.15);
  }
}

TEST(ScaleMixtureLoss, RecoversSigmaAndOutlierShare) {
  for (const double share : {0.02, 0.1, 0.3}) {
    const ScaleMixtureLoss loss(ContaminatedSamples(50000, 0.5, share, 15.0));
    EXPECT_NEAR(loss.CoreStd(), 0.5, 0.05) << share;
    // Of outliers of 30 sigma, 10 % lie within 4 sigma; the mixture knows.
    EXPECT_NEAR(loss.OutlierShare(), share, 0.15 * share) << share;
    // Redescends: an outlier of 15 px pulls far less than an inlier.
    double rho[3];
    loss.Evaluate(225.0, rho);
    EXPECT_LT(rho[1], 0.05 / 0.25);
  }
}

TEST(ScaleMixtureLoss, ScalesWithTheResiduals) {
  std::vector<NoiseSample> samples = ContaminatedSamples(5000, 0.5, 0.1, 15);
  const ScaleMixtureLoss loss(samples);
  const double factor = 64.0;
  for (NoiseSample& sample : samples) sample.squared *= factor * factor;
  const ScaleMixtureLoss scaled(samples);
  EXPECT_NEAR(scaled.CoreStd(), factor * loss.CoreStd(), 1e-6 * factor);
  double rho[3];
  double scaled_rho[3];
  loss.Evaluate(3.0, rho);
  scaled.Evaluate(3.0 * factor * factor, scaled_rho);
  EXPECT_NEAR(scaled_rho[0], rho[0], 1e-6);
}

TEST(ScaleMixtureLoss, WeightsCountLikeRepeatedSamples) {
  std::vector<NoiseSample> samples = ContaminatedSamples(2000, 0.5, 0.1, 15);
  std::vector<NoiseSample> weighted = samples;
  for (NoiseSample& sample : weighted) sample.weight = 0.25;
  double rho[3];
  double weighted_rho[3];
  ScaleMixtureLoss(samples).Evaluate(2.0, rho);
  ScaleMixtureLoss(weighted).Evaluate(2.0, weighted_rho);
  EXPECT_NEAR(rho[0], weighted_rho[0], 1e-9);
}

TEST(ScaleMixtureLoss, DegenerateSamplesGiveAValidLoss) {
  const std::vector<std::vector<NoiseSample>> cases = {
      {{0.25, 1.0}},                                // one sample
      {{0.25, 0.1}},                                // of little weight
      std::vector<NoiseSample>(1000, {0.25, 1.0}),  // identical
      std::vector<NoiseSample>(1000, {0.0, 1.0}),   // noise-free
      {{0.0, 1.0}},
      std::vector<NoiseSample>(1000, {1e12, 1.0}),
      {{0.25, 1.0}, {1e12, 1.0}},
      {{0.0, 1.0}, {0.0, 1.0}, {1e12, 1.0}}};
  for (size_t i = 0; i < cases.size(); ++i) {
    SCOPED_TRACE(i);
    const ScaleMixtureLoss loss(cases[i]);
    EXPECT_TRUE(std::isfinite(loss.CoreStd()) && loss.CoreStd() > 0.0);
    EXPECT_GE(loss.OutlierShare(), 0.0);
    EXPECT_LE(loss.OutlierShare(), 1.0 + 1e-12);
    ExpectValidLoss(loss);
  }
}

TEST(ScaleMixtureLoss, FarOutliersCountAsOutliers) {
  std::vector<NoiseSample> samples = ContaminatedSamples(9000, 0.5, 0.0, 1);
  samples.resize(10000, {1e12, 1.0});
  const ScaleMixtureLoss loss(samples);
  EXPECT_NEAR(loss.OutlierShare(), 0.1, 0.01);
  // Sigmas of the mixture are a factor of 1.41 apart.
  EXPECT_NEAR(loss.CoreStd(), 0.5, 0.075);
  ExpectValidLoss(loss);
}

}  // namespace
}  // namespace mfir
