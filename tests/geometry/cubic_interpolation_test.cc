#include "src/geometry/cubic_interpolation.h"

#include <cmath>
#include <limits>
#include <vector>

#include <gtest/gtest.h>

#include "src/util/random.h"

namespace mfir {
namespace {

double Interpolate(const std::vector<double>& samples,
                   double x,
                   double* derivative) {
  const CubicWeights weights =
      MakeCubicWeights(x, static_cast<int>(samples.size()));
  double value = 0.0;
  *derivative = 0.0;
  for (int i = 0; i < 4; ++i) {
    value += weights.weight[i] * samples[weights.begin + i];
    *derivative += weights.derivative[i] * samples[weights.begin + i];
  }
  return value;
}

std::vector<double> RandomSamples(int size) {
  Random random({3, static_cast<uint64_t>(size)});
  std::vector<double> samples;
  for (int i = 0; i < size; ++i) samples.push_back(random.Normal());
  return samples;
}

TEST(CubicWeights, HalfWayBetweenSamples) {
  const CubicWeights weights = MakeCubicWeights(7.5, 16);
  EXPECT_EQ(weights.begin, 6);
  const double expected[] = {-0.0625, 0.5625, 0.5625, -0.0625};
  const double derivatives[] = {0.125, -1.375, 1.375, -0.125};
  for (int i = 0; i < 4; ++i) {
    EXPECT_DOUBLE_EQ(weights.weight[i], expected[i]);
    EXPECT_DOUBLE_EQ(weights.derivative[i], derivatives[i]);
  }
}

TEST(CubicWeights, SumToOneEverywhere) {
  for (const int size : {4, 5, 16}) {
    for (double x = -3.0; x < size + 3.0; x += 0.01) {
      const CubicWeights weights = MakeCubicWeights(x, size);
      ASSERT_GE(weights.begin, 0);
      ASSERT_LE(weights.begin + 4, size);
      double sum = 0.0;
      double derivative_sum = 0.0;
      for (int i = 0; i < 4; ++i) {
        sum += weights.weight[i];
        derivative_sum += weights.derivative[i];
      }
      EXPECT_NEAR(sum, 1.0, 1e-14) << x;
      EXPECT_NEAR(derivative_sum, 0.0, 1e-13) << x;
    }
  }
}

TEST(CubicWeights, ParabolasAreExactUpToTheOutermostSamples) {
  for (const int size : {4, 5, 16}) {
    std::vector<double> samples;
    for (int i = 0; i < size; ++i) samples.push_back(0.7 + i * (0.3 - 0.2 * i));
    for (double x = 0.0; x <= size - 1; x += 1.0 / 64.0) {
      double derivative;
      EXPECT_NEAR(Interpolate(samples, x, &derivative),
                  0.7 + x * (0.3 - 0.2 * x),
                  1e-12)
          << x;
      EXPECT_NEAR(derivative, 0.3 - 0.4 * x, 1e-12) << x;
    }
  }
}

TEST(CubicWeights, DerivativeEqualsCentralDifferencesAndIsContinuous) {
  constexpr double kStep = 1e-6;
  const std::vector<double> samples = RandomSamples(6);
  double previous = 0.0;
  for (double x = -2.0; x <= 7.0; x += 1e-3) {
    double derivative;
    double unused;
    Interpolate(samples, x, &derivative);
    const double difference = (Interpolate(samples, x + kStep, &unused) -
                               Interpolate(samples, x - kStep, &unused)) /
                              (2.0 * kStep);
    // Half of the jump of the second derivative times the step at a node.
    ASSERT_NEAR(derivative, difference, 1e-4) << x;
    if (x > -2.0) {
      ASSERT_NEAR(derivative, previous, 0.1) << x;
    }
    previous = derivative;
  }
}

TEST(CubicWeights, PassesThroughTheSamples) {
  const std::vector<double> samples = RandomSamples(7);
  double derivative;
  for (int i = 0; i < 7; ++i) {
    EXPECT_NEAR(Interpolate(samples, i, &derivative), samples[i], 1e-14);
    if (i > 0 && i < 6) {
      EXPECT_NEAR(derivative, 0.5 * (samples[i + 1] - samples[i - 1]), 1e-14);
    }
  }
}

TEST(CubicWeights, ConstantOutside) {
  const std::vector<double> samples = RandomSamples(8);
  const double inf = std::numeric_limits<double>::infinity();
  double derivative;
  double edge = Interpolate(samples, -1.0, &derivative);
  EXPECT_EQ(derivative, 0.0);
  for (const double x : {-1.5, -100.0, -1e300, -inf, std::nan("")}) {
    EXPECT_EQ(Interpolate(samples, x, &derivative), edge) << x;
    EXPECT_EQ(derivative, 0.0) << x;
  }
  edge = Interpolate(samples, 8.0, &derivative);
  EXPECT_EQ(derivative, 0.0);
  for (const double x : {8.5, 100.0, 1e300, inf}) {
    EXPECT_EQ(Interpolate(samples, x, &derivative), edge) << x;
    EXPECT_EQ(derivative, 0.0) << x;
  }
}

}  // namespace
}  // namespace mfir
