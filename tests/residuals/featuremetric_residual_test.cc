#include "src/residuals/featuremetric_residual.h"

#include <limits>
#include <memory>
#include <vector>

#include <gtest/gtest.h>

#include "tests/support/test_features.h"
#include "tests/support/test_scenes.h"

namespace mfir {
namespace {

// One map of random values of order 1.
std::shared_ptr<CostMaps> RandomCostMaps(const Eigen::Vector2d& origin,
                                         double pixel_size,
                                         int patch_size) {
  auto maps = std::make_shared<CostMaps>();
  maps->patch_size = patch_size;
  maps->placements.push_back({origin, pixel_size});
  maps->data = RandomHalves(patch_size * patch_size * 3, 21);
  return maps;
}

Eigen::Vector3d Evaluate(const CostMaps& maps, const Eigen::Vector2d& xy) {
  Eigen::Vector3d residual;
  EvaluateFeaturemetric(maps, 0, xy, &residual, nullptr);
  return residual;
}

TEST(Featuremetric, HandComputed) {
  // Distance = x + 10 y, derivatives 1 and 10, in image coordinates.
  CostMaps maps;
  maps.patch_size = 16;
  maps.placements.push_back({Eigen::Vector2d(100.5, 50.5), 1.0});
  for (int row = 0; row < 16; ++row) {
    for (int column = 0; column < 16; ++column) {
      for (const double value : {column + 10.0 * row, 1.0, 10.0}) {
        maps.data.push_back(FloatToHalf(static_cast<float>(value)));
      }
    }
  }
  for (const Eigen::Vector2d& xy : {Eigen::Vector2d(100.5, 50.5),
                                    Eigen::Vector2d(107.8, 58.1),
                                    Eigen::Vector2d(115.5, 65.5),
                                    Eigen::Vector2d(100.6, 65.3)}) {
    Eigen::Vector3d residual;
    Matrix3x2 jacobian;
    EvaluateFeaturemetric(maps, 0, xy, &residual, &jacobian);
    const Eigen::Vector2d d = xy - Eigen::Vector2d(100.5, 50.5);
    EXPECT_NEAR(residual(0), d.x() + 10.0 * d.y(), 1e-9);
    EXPECT_NEAR(residual(1), 1.0, 1e-9);
    EXPECT_NEAR(residual(2), 10.0, 1e-9);
    EXPECT_NEAR(jacobian(0, 0), 1.0, 1e-9);
    EXPECT_NEAR(jacobian(0, 1), 10.0, 1e-9);
    EXPECT_LT(jacobian.bottomRows<2>().norm(), 1e-9);
  }
}

TEST(Featuremetric, BetweenFourElements) {
  // Weights of the Catmull-Rom spline half way: -1/16, 9/16, 9/16, -1/16.
  const auto maps = RandomCostMaps(Eigen::Vector2d(8.0, 4.0), 2.0, 16);
  const double weights[] = {-0.0625, 0.5625, 0.5625, -0.0625};
  Eigen::Vector3d expected = Eigen::Vector3d::Zero();
  for (int i = 0; i < 4; ++i) {
    for (int j = 0; j < 4; ++j) {
      for (int k = 0; k < 3; ++k) {
        expected(k) += weights[i] * weights[j] *
                       HalfToFloat(maps->data[((4 + i) * 16 + 9 + j) * 3 + k]);
      }
    }
  }
  // Element (10.5, 5.5).
  EXPECT_LT(
      (Evaluate(*maps, {8.0 + 2.0 * 10.5, 4.0 + 2.0 * 5.5}) - expected).norm(),
      1e-12);
}

TEST(Featuremetric, SecondMapHasItsOwnData) {
  auto maps = RandomCostMaps(Eigen::Vector2d::Zero(), 1.0, 8);
  maps->placements.push_back({Eigen::Vector2d(30.0, 40.0), 1.0});
  maps->data.resize(2 * 8 * 8 * 3, FloatToHalf(0.5f));
  Eigen::Vector3d residual;
  EvaluateFeaturemetric(*maps, 1, {33.0, 42.0}, &residual, nullptr);
  EXPECT_LT((residual - Eigen::Vector3d::Constant(0.5)).norm(), 1e-12);
}

TEST(Featuremetric, ContinuousAndHarmlessOutside) {
  const auto maps = RandomCostMaps(Eigen::Vector2d(0.5, 0.5), 1.0, 16);
  Random random({4});
  for (int i = 0; i < 200; ++i) {
    // A line out of the patch.
    const Eigen::Vector2d begin(random.Uniform(0.5, 15.5),
                                random.Uniform(0.5, 15.5));
    const double angle = random.Uniform(0.0, 6.3);
    const Eigen::Vector2d direction(std::cos(angle), std::sin(angle));
    Eigen::Vector3d previous = Evaluate(*maps, begin);
    for (double length = 0.0; length < 40.0; length += 1e-3) {
      const Eigen::Vector3d residual =
          Evaluate(*maps, begin + length * direction);
      ASSERT_LT((residual - previous).norm(), 0.05);
      previous = residual;
    }
    Matrix3x2 jacobian;
    EvaluateFeaturemetric(
        *maps, 0, begin + 40.0 * direction, &previous, &jacobian);
    // Outside by x or y at least; by both, nothing is left.
    const Eigen::Vector2d end = begin + 40.0 * direction;
    for (int axis = 0; axis < 2; ++axis) {
      if (end(axis) < -0.5 || end(axis) > 16.5) {
        EXPECT_EQ(jacobian.col(axis).norm(), 0.0);
      }
    }
  }
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_TRUE(Evaluate(*maps, {nan, nan}).allFinite());
  EXPECT_TRUE(Evaluate(*maps, {1e300, -1e300}).allFinite());
}

class FeaturemetricCostTest
    : public testing::TestWithParam<const CameraModel*> {};

INSTANTIATE_TEST_SUITE_P(All,
                         FeaturemetricCostTest,
                         testing::ValuesIn(AllCameraModels()),
                         [](const auto& info) { return info.param->Name(); });

TEST_P(FeaturemetricCostTest, JacobianEqualsCentralDifferences) {
  const CameraModel& model = *GetParam();
  Random random({12});
  for (int trial = 0; trial < 20; ++trial) {
    const Eigen::Quaterniond q = RandomRotation(&random);
    Eigen::Vector4d qvec(q.w(), q.x(), q.y(), q.z());
    Eigen::Vector3d tvec = RandomVector(&random);
    const Eigen::Vector3d p(random.Uniform(-0.5, 0.5),
                            random.Uniform(-0.5, 0.5),
                            random.Uniform(1.5, 3.0));
    Eigen::Vector3d xyz = q.conjugate() * (p - tvec);
    std::vector<double> params = TypicalParams(model);
    Eigen::Vector2d xy;
    model.Project(params.data(), p.x() / p.z(), p.y() / p.z(), xy.data());
    const auto maps = RandomCostMaps(
        xy - Eigen::Vector2d(random.Uniform(0.0, 30.0), 9.3), 2.0, 16);
    const FeaturemetricCost cost(&model, maps, 0);
    double* blocks[] = {qvec.data(), tvec.data(), xyz.data(), params.data()};
    Eigen::Vector3d residual;
    std::vector<std::vector<double>> jacobians;
    std::vector<double*> jacobian_data;
    for (const int32_t size : cost.parameter_block_sizes()) {
      jacobians.emplace_back(3 * size);
    }
    for (std::vector<double>& jacobian : jacobians) {
      jacobian_data.push_back(jacobian.data());
    }
    ASSERT_TRUE(cost.Evaluate(blocks, residual.data(), jacobian_data.data()));
    EXPECT_LT((residual - Evaluate(*maps, xy)).norm(), 1e-9);
    for (size_t b = 0; b < 4; ++b) {
      const int size = cost.parameter_block_sizes()[b];
      for (int i = 0; i < size; ++i) {
        const double value = blocks[b][i];
        const double step = 1e-7 * std::max(1.0, std::abs(value));
        Eigen::Vector3d after;
        Eigen::Vector3d before;
        blocks[b][i] = value + step;
        cost.Evaluate(blocks, after.data(), nullptr);
        blocks[b][i] = value - step;
        cost.Evaluate(blocks, before.data(), nullptr);
        blocks[b][i] = value;
        for (int k = 0; k < 3; ++k) {
          const double expected = (after(k) - before(k)) / (2.0 * step);
          EXPECT_NEAR(jacobians[b][k * size + i],
                      expected,
                      2e-3 + 2e-4 * std::abs(expected))
              << "block " << b << ", parameter " << i << ", channel " << k;
        }
      }
    }
  }
}

TEST_P(FeaturemetricCostTest, PointsBehindTheCameraOrInItAreHarmless) {
  const CameraModel& model = *GetParam();
  const auto maps = RandomCostMaps(Eigen::Vector2d(400.0, 300.0), 1.0, 16);
  const FeaturemetricCost cost(&model, maps, 0);
  const std::vector<double> params = TypicalParams(model);
  const double qvec[] = {1.0, 0.0, 0.0, 0.0};
  const double tvec[] = {0.0, 0.0, 0.0};
  for (const Eigen::Vector3d& xyz : {Eigen::Vector3d(1.0, 1.0, 0.0),
                                     Eigen::Vector3d(0.0, 0.0, 0.0),
                                     Eigen::Vector3d(1.0, 2.0, -1.0)}) {
    const double* blocks[] = {qvec, tvec, xyz.data(), params.data()};
    Eigen::Vector3d residual;
    const size_t max_size = std::max<size_t>(4, params.size());
    std::vector<std::vector<double>> jacobians(
        4, std::vector<double>(3 * max_size));
    double* jacobian_data[] = {jacobians[0].data(),
                               jacobians[1].data(),
                               jacobians[2].data(),
                               jacobians[3].data()};
    ASSERT_TRUE(cost.Evaluate(blocks, residual.data(), jacobian_data));
    EXPECT_TRUE(residual.allFinite());
    for (const std::vector<double>& jacobian : jacobians) {
      for (const double value : jacobian) EXPECT_TRUE(std::isfinite(value));
    }
  }
}

}  // namespace
}  // namespace mfir
