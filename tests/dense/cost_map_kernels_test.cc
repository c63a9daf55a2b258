#include "src/dense/cost_map_kernels.h"

#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "src/dense/cost_map_backend.h"
#include "tests/support/test_features.h"

namespace mfir {
namespace {

constexpr uint16_t kNan = 0x7e00;
constexpr uint16_t kInf = 0x7c00;

int64_t FindReference(const std::vector<uint16_t>& features, int num_channels) {
  const int64_t num_features =
      static_cast<int64_t>(features.size()) / num_channels;
  return CreateCpuCostMapBackend(1)->FindReferences(
      features, {0, num_features}, num_channels, 0.25f)[0];
}

std::vector<float> CostMap(const PatchShape& shape,
                           float inverse_pixel_size,
                           const std::vector<uint16_t>& patch,
                           const std::vector<uint16_t>& reference) {
  std::vector<uint16_t> cost_map(shape.NumCostElements());
  CreateCpuCostMapBackend(1)->ComputeMaps(
      shape,
      inverse_pixel_size,
      {{patch.data(), reference.data(), cost_map.data()}});
  std::vector<float> values;
  for (const uint16_t half : cost_map) values.push_back(HalfToFloat(half));
  return values;
}

// Robust mean by plain gradient-free reweighting, far beyond convergence.
int64_t PlainReference(const std::vector<uint16_t>& halves, int num_channels) {
  const Eigen::MatrixXd features =
      ToMatrix(halves.data(),
               num_channels,
               static_cast<int>(halves.size()) / num_channels);
  const double squared_scale = 0.0625 * features.colwise().squaredNorm().mean();
  Eigen::VectorXd mean = features.rowwise().mean();
  for (int i = 0; i < 2000; ++i) {
    const Eigen::ArrayXd weights = (1.0 + (features.colwise() - mean)
                                                  .colwise()
                                                  .squaredNorm()
                                                  .transpose()
                                                  .array() /
                                              squared_scale)
                                       .inverse();
    mean = features * weights.matrix() / weights.sum();
  }
  Eigen::Index nearest;
  (features.colwise() - mean).colwise().squaredNorm().minCoeff(&nearest);
  return nearest;
}

TEST(ReferenceFeature, IsNearestToTheRobustMean) {
  Random random({5});
  for (const int length : {3, 7, 38, 500}) {
    for (const int num_channels : {1, 3, 64, 128, 200}) {
      // A cluster, and a third of the features somewhere else.
      std::vector<double> features;
      std::vector<double> center(num_channels);
      for (double& value : center) {
        value = random.Normal() / std::sqrt(num_channels);
      }
      for (int i = 0; i < length; ++i) {
        const double spread = i % 3 == 2 ? 2.0 : 0.1;
        for (const double value : center) {
          features.push_back(value + spread * random.Normal() /
                                         std::sqrt(num_channels));
        }
      }
      const std::vector<uint16_t> halves = ToHalf(features);
      EXPECT_EQ(FindReference(halves, num_channels),
                PlainReference(halves, num_channels))
          << length << " features of " << num_channels << " channels";
    }
  }
}

TEST(ReferenceFeature, OutliersDoNotMoveIt) {
  // The mean is 2.35, nearest to 1.3; the robust mean lies near 1.06.
  const std::vector<uint16_t> features =
      ToHalf({1.0, 1.01, 0.99, 1.3, 6.0, 6.5, 1.02, 0.98});
  EXPECT_EQ(FindReference(features, 1), 6);
}

TEST(ReferenceFeature, UnitOfTheFeaturesDoesNotMatter) {
  std::vector<double> values;
  Random random({9});
  for (int i = 0; i < 12 * 16; ++i) values.push_back(random.Uniform(0.5, 1.0));
  std::vector<uint16_t> features = ToHalf(values);
  const int64_t reference = FindReference(features, 16);
  for (const double factor : {0.0625, 1024.0}) {
    std::vector<double> scaled;
    for (const uint16_t half : features) {
      scaled.push_back(factor * HalfToFloat(half));
    }
    EXPECT_EQ(FindReference(ToHalf(scaled), 16), reference);
  }
}

TEST(ReferenceFeature, DegenerateTracks) {
  const std::vector<uint16_t> one = RandomHalves(128, 1);
  EXPECT_EQ(FindReference(one, 128), 0);
  EXPECT_EQ(FindReference(std::vector<uint16_t>(7 * 128, 0), 128), 0);
  std::vector<uint16_t> identical;
  for (int i = 0; i < 500; ++i) {
    identical.insert(identical.end(), one.begin(), one.end());
  }
  EXPECT_EQ(FindReference(identical, 128), 0);
  EXPECT_EQ(FindReference(std::vector<uint16_t>(5 * 8, 0x7bff), 8), 0);
  const auto none =
      CreateCpuCostMapBackend(1)->FindReferences({}, {0, 0}, 128, 0.25f);
  EXPECT_EQ(none, std::vector<int64_t>{-1});
}

TEST(ReferenceFeature, FeaturesThatAreNotFiniteTakeNoPart) {
  for (const uint16_t bad : {kNan, kInf, static_cast<uint16_t>(0xfc00)}) {
    EXPECT_EQ(FindReference(std::vector<uint16_t>(3 * 16, bad), 16), -1);
    std::vector<uint16_t> features = RandomHalves(6 * 16, 2);
    std::vector<uint16_t> with_bad = features;
    with_bad.insert(with_bad.begin(), 16, 0);
    with_bad[5] = bad;
    EXPECT_EQ(FindReference(with_bad, 16), FindReference(features, 16) + 1);
  }
}

TEST(ReferenceFeature, TracksKeepTheirRows) {
  const std::vector<uint16_t> features = RandomHalves(10 * 4, 3);
  const auto references = CreateCpuCostMapBackend(2)->FindReferences(
      features, {0, 3, 3, 4, 10}, 4, 0.25f);
  ASSERT_EQ(references.size(), 4u);
  EXPECT_LT(references[0], 3);
  EXPECT_EQ(references[1], -1);
  EXPECT_EQ(references[2], 3);
  EXPECT_GE(references[3], 4);
}

TEST(CostMap, EqualsItsDefinition) {
  for (const int patch_size : {4, 5, 10, 16, 24}) {
    for (const int num_channels : {1, 31, 128, 129, 300}) {
      const PatchShape shape = {patch_size, num_channels};
      const std::vector<uint16_t> patch = RandomHalves(shape.NumElements(), 4);
      const std::vector<uint16_t> reference = RandomHalves(num_channels, 5);
      const std::vector<double> expected =
          PlainCostMap(shape, 2.0, patch.data(), reference.data());
      const std::vector<float> values = CostMap(shape, 0.5f, patch, reference);
      for (size_t i = 0; i < expected.size(); ++i) {
        // Half a unit in the last place of fp16, and rounding of the sums.
        ASSERT_NEAR(values[i],
                    expected[i],
                    4.9e-4 * std::abs(expected[i]) + 2e-5 * num_channels)
            << patch_size << " " << num_channels << " " << i;
      }
    }
  }
}

TEST(CostMap, HandComputed) {
  // One channel F = column^2 + row, f = 1.
  const PatchShape shape = {4, 1};
  std::vector<double> patch;
  for (int row = 0; row < 4; ++row) {
    for (int column = 0; column < 4; ++column) {
      patch.push_back(column * column + row);
    }
  }
  const std::vector<float> values =
      CostMap(shape, 1.0f, ToHalf(patch), ToHalf({1.0}));
  for (int row = 0; row < 4; ++row) {
    for (int column = 0; column < 4; ++column) {
      const int difference = column * column + row - 1;
      const int sign = (difference > 0) - (difference < 0);
      const float* value = &values[(row * 4 + column) * 3];
      EXPECT_EQ(value[0], std::abs(difference));
      // Exact derivatives of a parabola, at the border too.
      EXPECT_EQ(value[1], sign * 2 * column);
      EXPECT_EQ(value[2], sign);
    }
  }
}

TEST(CostMap, IdenticalFeaturesCostNothing) {
  const PatchShape shape = {16, 128};
  const std::vector<uint16_t> reference = RandomHalves(128, 6);
  std::vector<uint16_t> patch;
  for (int i = 0; i < shape.NumPixels(); ++i) {
    patch.insert(patch.end(), reference.begin(), reference.end());
  }
  for (const float value : CostMap(shape, 1.0f, patch, reference)) {
    EXPECT_EQ(value, 0.0f);
  }
}

TEST(CostMap, FeaturesThatAreNotFiniteShow) {
  const PatchShape shape = {8, 16};
  for (const uint16_t bad : {kNan, kInf}) {
    std::vector<uint16_t> patch = RandomHalves(shape.NumElements(), 7);
    patch[(3 * 8 + 4) * 16 + 9] = bad;
    const std::vector<float> values =
        CostMap(shape, 1.0f, patch, RandomHalves(16, 8));
    EXPECT_TRUE(std::isnan(values[(3 * 8 + 4) * 3]));
    EXPECT_FALSE(std::isnan(values[0]));
  }
}

TEST(CostMap, LargeFeaturesAreClamped) {
  const PatchShape shape = {4, 32};
  std::vector<uint16_t> patch(shape.NumElements(), 0x7bff);
  const std::vector<uint16_t> reference(32, 0xfbff);
  for (size_t i = 0; i < patch.size(); i += 5) patch[i] = 0;
  for (const float value : CostMap(shape, 1.0f, patch, reference)) {
    EXPECT_TRUE(std::isfinite(value));
    EXPECT_LE(std::abs(value), kMaxHalf);
  }
}

TEST(CostMap, SameForAllNumbersOfThreads) {
  const PatchShape shape = {16, 128};
  const std::vector<uint16_t> patches =
      RandomHalves(200 * shape.NumElements(), 9);
  const std::vector<uint16_t> reference = RandomHalves(128, 10);
  std::vector<std::vector<uint16_t>> results;
  for (const int num_threads : {1, 3}) {
    results.emplace_back(200 * shape.NumCostElements());
    std::vector<CostMapJob> jobs;
    for (size_t i = 0; i < 200; ++i) {
      jobs.push_back({patches.data() + i * shape.NumElements(),
                      reference.data(),
                      results.back().data() + i * shape.NumCostElements()});
    }
    CreateCpuCostMapBackend(num_threads)->ComputeMaps(shape, 1.0f, jobs);
  }
  EXPECT_EQ(results[0], results[1]);
}

}  // namespace
}  // namespace mfir
