#include "src/patches/patch_alignment.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include <gtest/gtest.h>

#include "src/util/random.h"
#include "tests/support/patch_images.h"

namespace mfir {
namespace {

constexpr size_t kWidth = 60;
constexpr size_t kHeight = 50;

PatchWarp Shift(double x, double y) {
  return {{x, y}, {1.0f, 0.0f, 0.0f, 1.0f}, {}};
}

// The spline of an image at a position.
float Sample(const SplineImage& image, double x, double y) {
  const PatchWarp warp = Shift(x, y);
  return SampleOffset(MakeSplineWindow(image.View(), warp), warp, 0.0f, 0.0f);
}

TEST(SplineWeights, HandComputedValues) {
  float w[4];
  CubicSplineWeights(0.0f, w);
  EXPECT_FLOAT_EQ(w[0], 1.0f / 6.0f);
  EXPECT_FLOAT_EQ(w[1], 2.0f / 3.0f);
  EXPECT_FLOAT_EQ(w[2], 1.0f / 6.0f);
  EXPECT_FLOAT_EQ(w[3], 0.0f);
  CubicSplineWeights(0.5f, w);
  EXPECT_FLOAT_EQ(w[0], 1.0f / 48.0f);
  EXPECT_FLOAT_EQ(w[1], 23.0f / 48.0f);
  EXPECT_FLOAT_EQ(w[2], 23.0f / 48.0f);
  EXPECT_FLOAT_EQ(w[3], 1.0f / 48.0f);
  float d[4];
  CubicSplineDerivatives(0.5f, d);
  EXPECT_FLOAT_EQ(d[0], -0.125f);
  EXPECT_FLOAT_EQ(d[1], -0.625f);
  EXPECT_FLOAT_EQ(d[2], 0.625f);
  EXPECT_FLOAT_EQ(d[3], 0.125f);
}

TEST(SplineWeights, DerivativesAreThoseOfTheWeights) {
  constexpr float kStep = 1e-3f;
  for (float t = 0.1f; t < 0.95f; t += 0.1f) {
    float d[4], plus[4], minus[4];
    CubicSplineDerivatives(t, d);
    CubicSplineWeights(t + kStep, plus);
    CubicSplineWeights(t - kStep, minus);
    for (int i = 0; i < 4; ++i) {
      EXPECT_NEAR(d[i], (plus[i] - minus[i]) / (2.0f * kStep), 1e-3f);
    }
  }
}

TEST(SplineImage, GoesThroughThePixels) {
  Random random({3});
  std::vector<float> pixels;
  for (size_t i = 0; i < kWidth * kHeight; ++i) {
    pixels.push_back(static_cast<float>(random.Integer(0, 255)));
  }
  const SplineImage image(kWidth, kHeight, pixels);
  for (size_t y = 1; y + 3 < kHeight; ++y) {
    for (size_t x = 1; x + 3 < kWidth; ++x) {
      ASSERT_NEAR(Sample(image,
                         static_cast<double>(x) + 0.5,
                         static_cast<double>(y) + 0.5),
                  pixels[y * kWidth + x],
                  2e-3)
          << x << " " << y;
    }
  }
}

TEST(SplineImage, FollowsASmoothFunctionBetweenThePixels) {
  const auto function = [](double x, double y) {
    return 100.0 + 50.0 * std::sin(0.5 * x) * std::cos(0.3 * y);
  };
  const SplineImage image = RenderFunction(kWidth, kHeight, function);
  for (const double offset : {0.1, 0.25, 0.5, 0.9}) {
    EXPECT_NEAR(Sample(image, 20.5 + offset, 30.5 - offset),
                function(20.5 + offset, 30.5 - offset),
                0.02);
  }
}

TEST(SplineImage, OneRowOrColumn) {
  const SplineImage row(5, 1, {1, 2, 3, 4, 5});
  const SplineImage column(1, 5, {7, 7, 7, 7, 7});
  EXPECT_FALSE(row.Empty());
  for (int i = 0; i < 5; ++i) {
    EXPECT_NEAR(column.View().coefficients[i], 7.0f, 1e-4f);
  }
  EXPECT_TRUE(SplineImage().Empty());
}

TEST(PatchDisc, HasThePixelsOfACircle) {
  // Rows of a disc of radius 5: 1, 7, 9, 9, 9, 11, 9, 9, 9, 7, 1.
  EXPECT_EQ(kNumPatchSamples, 81);
  EXPECT_EQ(kPatchStride % 16, 0);
  const PatchDisc& disc = GetPatchDisc();
  EXPECT_EQ(disc.u[0], 0.0f);
  EXPECT_EQ(disc.v[0], -5.0f);
  EXPECT_EQ(disc.u[40], 0.0f);
  EXPECT_EQ(disc.v[40], 0.0f);
}

TEST(PatchTemplate, ZeroMeanUnitVarianceAndInverse) {
  const WaveTexture texture(6.0, 1);
  const SplineImage image = RenderFunction(
      kWidth, kHeight, [&](double x, double y) { return texture.Value(x, y); });
  PatchTemplate patch;
  ASSERT_TRUE(MakePatchTemplate(image, {30.2, 25.7}, &patch));
  double sum = 0.0, squared = 0.0;
  for (int i = 0; i < kPatchStride; ++i) {
    sum += patch.basis[kGainIdx][i];
    squared += patch.basis[kGainIdx][i] * patch.basis[kGainIdx][i];
  }
  EXPECT_NEAR(sum, 0.0, 1e-3);
  EXPECT_NEAR(squared, kNumPatchSamples, 1e-2);
  // The projector finds each basis function's own coefficient.
  for (int k = 0; k < kNumPatchBasis; ++k) {
    for (int j = 0; j < kNumPatchBasis; ++j) {
      double product = 0.0;
      for (int i = 0; i < kPatchStride; ++i) {
        product += patch.projector[k][i] * patch.basis[j][i];
      }
      EXPECT_NEAR(product, k == j ? 1.0 : 0.0, 1e-3) << k << " " << j;
    }
  }
}

TEST(PatchTemplate, RefusesBordersAndFlatPatches) {
  const SplineImage flat =
      RenderFunction(kWidth, kHeight, [](double, double) { return 80.0; });
  const SplineImage stripes = RenderFunction(
      kWidth, kHeight, [](double x, double) { return 80.0 + 40 * sin(x); });
  const WaveTexture texture(6.0, 1);
  const SplineImage image = RenderFunction(
      kWidth, kHeight, [&](double x, double y) { return texture.Value(x, y); });
  PatchTemplate patch;
  EXPECT_FALSE(MakePatchTemplate(flat, {30.0, 25.0}, &patch));
  // Along the stripes nothing is determined.
  EXPECT_FALSE(MakePatchTemplate(stripes, {30.0, 25.0}, &patch));
  EXPECT_FALSE(MakePatchTemplate(image, {5.0, 25.0}, &patch));
  EXPECT_FALSE(MakePatchTemplate(image, {30.0, 46.0}, &patch));
  EXPECT_FALSE(MakePatchTemplate(
      image, {std::numeric_limits<double>::quiet_NaN(), 25.0}, &patch));
  EXPECT_TRUE(MakePatchTemplate(image, {30.0, 25.0}, &patch));
}

// The other image shows texture(x) at affine * (x - center) + other_center,
// with another gain and offset.
struct AffinePair {
  WaveTexture texture{6.0, 5};
  Eigen::Vector2d center{30.3, 24.6};
  Eigen::Vector2d other_center{31.7, 25.2};
  Eigen::Matrix2d affine;

  AffinePair() { affine << 1.1, 0.15, -0.1, 0.9; }

  SplineImage Reference() const {
    return RenderFunction(kWidth, kHeight, [&](double x, double y) {
      return texture.Value(x, y);
    });
  }
  SplineImage Other(double noise_sigma, uint64_t seed) const {
    Random random({seed, 11});
    const Eigen::Matrix2d inverse = affine.inverse();
    return RenderFunction(kWidth, kHeight, [&](double x, double y) {
      const Eigen::Vector2d p =
          center + inverse * (Eigen::Vector2d(x, y) - other_center);
      return 0.7 * texture.Value(p.x(), p.y()) + 20.0 +
             (noise_sigma > 0.0 ? random.Normal(0.0, noise_sigma) : 0.0);
    });
  }
};

// The warp of the pair, off its centre.
PatchWarp NearWarp(const AffinePair& pair, double dx, double dy) {
  PatchWarp warp =
      Shift(pair.other_center.x() + dx, pair.other_center.y() + dy);
  for (int i = 0; i < 4; ++i) {
    warp.affine[i] = static_cast<float>(pair.affine(i / 2, i % 2));
  }
  return warp;
}

TEST(AlignPatch, FindsThePlaceAndKeepsTheShape) {
  const AffinePair pair;
  PatchTemplate patch;
  ASSERT_TRUE(MakePatchTemplate(pair.Reference(), pair.center, &patch));
  const SplineImage other = pair.Other(0.0, 0);
  for (const auto& [dx, dy] :
       {std::make_pair(-0.6, 0.7), std::make_pair(1.3, 0.9)}) {
    PatchWarp warp = NearWarp(pair, dx, dy);
    const PatchAlignment result = AlignPatch(patch, other, &warp);
    ASSERT_EQ(result.end, PatchEnd::kConverged);
    EXPECT_NEAR(warp.center[0], pair.other_center.x(), 0.005);
    EXPECT_NEAR(warp.center[1], pair.other_center.y(), 0.005);
    for (int i = 0; i < 4; ++i) {
      EXPECT_EQ(warp.affine[i], static_cast<float>(pair.affine(i / 2, i % 2)));
    }
    EXPECT_GT(result.zncc, 0.999f);
    EXPECT_LT(PatchStd(result), 0.02);
  }
}

// R = (1, -1, 1, -1, ...), gradients with periods of 4 and 8, all orthogonal:
// samples 3 (R + 0.5 R_x - 0.25 R_y) + 5.
TEST(FindPatchShift, HandComputedShift) {
  PatchTemplate patch = {};
  float samples[kPatchStride] = {};
  // The last of 81 samples is zero everywhere.
  for (int i = 0; i < 80; ++i) {
    patch.basis[kGainIdx][i] = i % 2 == 0 ? 1.0f : -1.0f;
    patch.basis[kOffsetIdx][i] = 1.0f;
    patch.gradient[0][i] = i % 4 < 2 ? 1.0f : -1.0f;
    patch.gradient[1][i] = i % 8 < 4 ? 1.0f : -1.0f;
    samples[i] =
        3.0f * (patch.basis[kGainIdx][i] + 0.5f * patch.gradient[0][i] -
                0.25f * patch.gradient[1][i]) +
        5.0f;
  }
  patch.gradient_inverse[0] = 1.0f / 80.0f;
  patch.gradient_inverse[2] = 1.0f / 80.0f;
  PatchShift shift;
  ASSERT_TRUE(FindPatchShift(SerialGroup(), patch, samples, &shift));
  // The gain is a little low: 80 of 81.
  EXPECT_NEAR(shift.u, 0.5, 0.01);
  EXPECT_NEAR(shift.v, -0.25, 0.01);
  // A power of 9 beside 9 (0.25 + 0.0625).
  EXPECT_NEAR(shift.zncc, 1.0 / std::sqrt(1.3125), 0.02);
  for (float& sample : samples) sample = -sample;
  EXPECT_FALSE(FindPatchShift(SerialGroup(), patch, samples, &shift));
}

TEST(PatchTemplate, GradientIsThatOfThePatch) {
  const AffinePair pair;
  const SplineImage image = pair.Reference();
  PatchTemplate patch;
  ASSERT_TRUE(MakePatchTemplate(image, pair.center, &patch));
  double products[2][2] = {};
  for (int j = 0; j < 2; ++j) {
    double by_patch = 0.0, by_one = 0.0;
    for (int i = 0; i < kPatchStride; ++i) {
      by_patch += patch.gradient[j][i] * patch.basis[kGainIdx][i];
      by_one += patch.gradient[j][i] * patch.basis[kOffsetIdx][i];
      for (int k = 0; k < 2; ++k) {
        products[j][k] += patch.gradient[j][i] * patch.gradient[k][i];
      }
    }
    EXPECT_NEAR(by_patch, 0.0, 1e-3);
    EXPECT_NEAR(by_one, 0.0, 1e-3);
  }
  const float* inverse = patch.gradient_inverse;
  for (int j = 0; j < 2; ++j) {
    EXPECT_NEAR(products[j][0] * inverse[0] + products[j][1] * inverse[1],
                j == 0 ? 1.0 : 0.0,
                1e-3);
    EXPECT_NEAR(products[j][0] * inverse[1] + products[j][1] * inverse[2],
                j == 1 ? 1.0 : 0.0,
                1e-3);
  }
}

TEST(AlignPatch, QuadraticPartIsKept) {
  const AffinePair pair;
  const SplineImage reference = pair.Reference();
  PatchTemplate patch;
  ASSERT_TRUE(MakePatchTemplate(reference, pair.center, &patch));
  const float q = 0.01f;
  // x = center + u + (q u u, q u v), solved for u.
  const SplineImage other =
      RenderFunction(kWidth, kHeight, [&](double x, double y) {
        const double dx = x - pair.other_center.x();
        const double dy = y - pair.other_center.y();
        const double u =
            (std::sqrt(std::max(1.0 + 4.0 * q * dx, 0.01)) - 1.0) / (2.0 * q);
        const double v = dy / (1.0 + q * u);
        return pair.texture.Value(pair.center.x() + u, pair.center.y() + v);
      });
  PatchWarp warp = Shift(31.2, 25.6);
  warp.quadratic[0] = q;
  warp.quadratic[4] = q;
  ASSERT_EQ(AlignPatch(patch, other, &warp).end, PatchEnd::kConverged);
  EXPECT_NEAR(warp.center[0], pair.other_center.x(), 0.01);
  EXPECT_NEAR(warp.center[1], pair.other_center.y(), 0.01);
}

TEST(AlignPatch, PredictedStdHolds) {
  const AffinePair pair;
  PatchTemplate patch;
  ASSERT_TRUE(MakePatchTemplate(pair.Reference(), pair.center, &patch));
  constexpr int kNumTrials = 200;
  double squared = 0.0, predicted = 0.0;
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (int i = 0; i < kNumTrials; ++i) {
    PatchWarp warp = NearWarp(pair, -0.3, 0.2);
    const PatchAlignment result =
        AlignPatch(patch, pair.Other(3.0, i + 1), &warp);
    ASSERT_EQ(result.end, PatchEnd::kConverged);
    const float trace = result.covariance[0] + result.covariance[2];
    predicted += trace;
    const Eigen::Vector2d error(warp.center[0] - pair.other_center.x(),
                                warp.center[1] - pair.other_center.y());
    squared += error.squaredNorm();
    mean += error / kNumTrials;
    const double std = PatchStd(result);
    EXPECT_GE(std * std * 2.0, trace * 0.999);
    EXPECT_LE(std * std, trace * 1.001);
  }
  // On the small side: interpolation smooths a part of the noise away.
  EXPECT_NEAR(std::sqrt(squared / predicted), 1.1, 0.15);
  EXPECT_LT(mean.norm(), 0.02);
}

TEST(AlignPatch, SaysWhyItFails) {
  const AffinePair pair;
  const SplineImage other = pair.Other(0.0, 0);
  PatchTemplate patch;
  ASSERT_TRUE(MakePatchTemplate(pair.Reference(), pair.center, &patch));
  PatchWarp warp = Shift(3.0, 25.0);
  EXPECT_EQ(AlignPatch(patch, other, &warp).end, PatchEnd::kOutside);
  warp = Shift(std::numeric_limits<double>::infinity(), 25.0);
  EXPECT_EQ(AlignPatch(patch, other, &warp).end, PatchEnd::kOutside);
  const SplineImage negative =
      RenderFunction(kWidth, kHeight, [&](double x, double y) {
        return 255.0 - pair.texture.Value(x, y);
      });
  warp = Shift(pair.center.x(), pair.center.y());
  EXPECT_EQ(AlignPatch(patch, negative, &warp).end, PatchEnd::kDissimilar);
  // Further than the alignment may move.
  warp = NearWarp(pair, 0.0, 0.0);
  const SplineImage ramp =
      RenderFunction(kWidth, kHeight, [](double x, double) { return 2.0 * x; });
  EXPECT_NE(AlignPatch(patch, ramp, &warp).end, PatchEnd::kConverged);
}

TEST(SearchPatch, FindsWholeShifts) {
  const WaveTexture texture(6.0, 5);
  const SplineImage image = RenderFunction(
      kWidth, kHeight, [&](double x, double y) { return texture.Value(x, y); });
  PatchTemplate patch;
  ASSERT_TRUE(MakePatchTemplate(image, {30.0, 25.0}, &patch));
  PatchWarp warp = Shift(33.0, 21.0);
  EXPECT_NEAR(SearchPatch(patch, image, &warp), 1.0f, 1e-3f);
  EXPECT_DOUBLE_EQ(warp.center[0], 30.0);
  EXPECT_DOUBLE_EQ(warp.center[1], 25.0);
  // Through the affine map: two pixels of the reference are four here.
  warp = Shift(26.0, 25.0);
  for (float& entry : warp.affine) entry *= 2.0f;
  SearchPatch(patch, image, &warp);
  EXPECT_NEAR(std::fmod(warp.center[0], 2.0), 0.0, 1e-6);
  // Too near to the border: the warp stays.
  warp = Shift(8.0, 25.0);
  EXPECT_EQ(SearchPatch(patch, image, &warp), -1.0f);
  EXPECT_EQ(warp.center[0], 8.0);
}

}  // namespace
}  // namespace mfir
