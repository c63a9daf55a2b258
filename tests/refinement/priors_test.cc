#include "src/refinement/priors.h"

#include <memory>

#include <gtest/gtest.h>

#include "tests/support/test_scenes.h"

namespace mfir {
namespace {

Eigen::Vector4d Qvec(const Eigen::Quaterniond& q) {
  return {q.w(), q.x(), q.y(), q.z()};
}

// Residual of R against Rhat, rad.
Eigen::Vector3d RotationResidual(const Eigen::Quaterniond& rotation,
                                 const Eigen::Quaterniond& known) {
  const std::unique_ptr<ceres::CostFunction> cost(
      RotationPriorCost::Create(known));
  const Eigen::Vector4d qvec = Qvec(rotation);
  const double* blocks[] = {qvec.data()};
  Eigen::Vector3d residual;
  EXPECT_TRUE(cost->Evaluate(blocks, residual.data(), nullptr));
  return residual;
}

// Compares all Jacobians with central differences, relative to their norm.
void ExpectJacobiansMatch(const ceres::CostFunction& cost,
                          std::vector<std::vector<double>> blocks,
                          double step,
                          double tolerance) {
  const int rows = cost.num_residuals();
  std::vector<const double*> pointers;
  std::vector<std::vector<double>> jacobians;
  std::vector<double*> jacobian_pointers;
  for (const std::vector<double>& block : blocks) {
    jacobians.emplace_back(rows * block.size());
    pointers.push_back(block.data());
  }
  for (std::vector<double>& jacobian : jacobians) {
    jacobian_pointers.push_back(jacobian.data());
  }
  std::vector<double> residuals(rows);
  std::vector<double> plus(rows);
  std::vector<double> minus(rows);
  ASSERT_TRUE(cost.Evaluate(
      pointers.data(), residuals.data(), jacobian_pointers.data()));
  for (size_t b = 0; b < blocks.size(); ++b) {
    double norm = 0.0;
    for (const double value : jacobians[b]) norm = std::hypot(norm, value);
    for (size_t i = 0; i < blocks[b].size(); ++i) {
      const double value = blocks[b][i];
      blocks[b][i] = value + step;
      ASSERT_TRUE(cost.Evaluate(pointers.data(), plus.data(), nullptr));
      blocks[b][i] = value - step;
      ASSERT_TRUE(cost.Evaluate(pointers.data(), minus.data(), nullptr));
      blocks[b][i] = value;
      for (int row = 0; row < rows; ++row) {
        EXPECT_NEAR(jacobians[b][row * blocks[b].size() + i],
                    (plus[row] - minus[row]) / (2.0 * step),
                    tolerance * norm)
            << "block " << b << ", parameter " << i << ", residual " << row;
      }
    }
  }
}

TEST(RotationPrior, IsTheLogOfTheRelativeRotationInRad) {
  // Both about z: R = 50 degrees, Rhat = 20 degrees -> r = (0, 0, 30 degrees).
  const auto about_z = [](double degrees) {
    return Rotation(Eigen::Vector3d(0, 0, degrees * M_PI / 180));
  };
  const Eigen::Vector3d residual = RotationResidual(about_z(50), about_z(20));
  EXPECT_LT((residual - Eigen::Vector3d(0, 0, M_PI / 6)).norm(), 1e-14);
}

TEST(RotationPrior, IsRRhatTransposedNotRhatTransposedR) {
  // R = Rx(90) Rz(90), Rhat = Rz(90): R Rhat^T = Rx(90), Rhat^T R = Ry(-90).
  const Eigen::Quaterniond known = Rotation(Eigen::Vector3d(0, 0, M_PI / 2));
  const Eigen::Quaterniond rotation =
      Rotation(Eigen::Vector3d(M_PI / 2, 0, 0)) * known;
  EXPECT_LT(
      (RotationResidual(rotation, known) - Eigen::Vector3d(M_PI / 2, 0, 0))
          .norm(),
      1e-14);
}

TEST(RotationPrior, NormIsTheAngleForRandomRotations) {
  Random random({3});
  for (int i = 0; i < 100; ++i) {
    const Eigen::Quaterniond a = RandomRotation(&random);
    const Eigen::Quaterniond b = RandomRotation(&random);
    EXPECT_NEAR(RotationResidual(a, b).norm(), a.angularDistance(b), 1e-12);
  }
}

TEST(RotationPrior, SignAndNormOfQuaternionDoNotMatter) {
  Random random({4});
  for (int i = 0; i < 20; ++i) {
    const Eigen::Quaterniond a = RandomRotation(&random);
    const Eigen::Quaterniond b = RandomRotation(&random);
    const Eigen::Quaterniond minus_a(-a.coeffs());
    const Eigen::Quaterniond minus_b(-b.coeffs());
    const Eigen::Vector3d expected = RotationResidual(a, b);
    EXPECT_LT((RotationResidual(minus_a, b) - expected).norm(), 1e-13);
    EXPECT_LT((RotationResidual(a, minus_b) - expected).norm(), 1e-13);
    EXPECT_LT((RotationResidual(minus_a, minus_b) - expected).norm(), 1e-13);
    EXPECT_LT(
        (RotationResidual(Eigen::Quaterniond(3.0 * a.coeffs()), b) - expected)
            .norm(),
        1e-13);
  }
}

// Angle-axis vectors of both rotations jump from +pi to -pi; the prior must
// not.
TEST(RotationPrior, DoesNotJumpWhereTheAngleOfBothPassesPi) {
  const Eigen::Vector3d axis = Eigen::Vector3d(1, 2, 3).normalized();
  for (const double angle : {M_PI - 1e-3, M_PI, M_PI + 1e-3}) {
    const Eigen::Quaterniond known = Rotation(angle * axis);
    for (const double difference : {-2e-3, -1e-9, 0.0, 1e-9, 2e-3}) {
      const Eigen::Vector3d residual =
          RotationResidual(Rotation((angle + difference) * axis), known);
      EXPECT_LT((residual - difference * axis).norm(), 1e-14)
          << angle << " " << difference;
    }
  }
}

TEST(RotationPrior, NormIsContinuousWhereTheDifferencePassesPi) {
  const Eigen::Vector3d axis = Eigen::Vector3d(-1, 2, 0.5).normalized();
  const Eigen::Quaterniond known = Rotation(Eigen::Vector3d(0.3, 0.2, -0.4));
  for (const double excess : {-1e-3, -1e-12, 0.0, 1e-12, 1e-3}) {
    EXPECT_NEAR(
        RotationResidual(Rotation((M_PI + excess) * axis) * known, known)
            .norm(),
        M_PI - std::abs(excess),
        1e-12);
  }
}

TEST(RotationPrior, JacobianEqualsCentralDifferences) {
  Random random({5});
  for (const double angle : {0.0, 1e-9, 1e-4, 0.1, 1.0, 3.0, 3.14}) {
    const Eigen::Quaterniond known = RandomRotation(&random);
    const Eigen::Quaterniond rotation =
        Rotation(angle * RandomVector(&random).normalized()) * known;
    const std::unique_ptr<ceres::CostFunction> cost(
        RotationPriorCost::Create(known));
    const Eigen::Vector4d qvec = Qvec(rotation);
    ExpectJacobiansMatch(*cost, {{qvec.data(), qvec.data() + 4}}, 1e-7, 1e-6);
  }
}

TEST(TranslationPrior, IsTheDifferenceInWorldUnits) {
  const std::unique_ptr<ceres::CostFunction> cost(
      TranslationPriorCost::Create(Eigen::Vector3d(1, 2, 3)));
  const Eigen::Vector3d tvec(1.5, 1, 7);
  const double* blocks[] = {tvec.data()};
  Eigen::Vector3d residual;
  ASSERT_TRUE(cost->Evaluate(blocks, residual.data(), nullptr));
  EXPECT_EQ(residual, Eigen::Vector3d(0.5, -1, 4));
  ExpectJacobiansMatch(*cost, {{1.5, 1, 7}}, 1e-4, 1e-9);
}

TEST(IntrinsicsVariance, IsTheScaledDifferenceToTheGlobalOnesInPx) {
  // Parameters 0 and 3; the latter moves a corner by 200 px per unit.
  const std::unique_ptr<ceres::CostFunction> cost(
      IntrinsicsVarianceCost::Create(4, {{0, 1.0}, {3, 200.0}}));
  const std::vector<double> image = {1010, 400, 300, -0.10};
  const std::vector<double> global = {1000, 411, 322, -0.12};
  const double* blocks[] = {image.data(), global.data()};
  Eigen::Vector2d residual;
  ASSERT_EQ(cost->num_residuals(), 2);
  ASSERT_TRUE(cost->Evaluate(blocks, residual.data(), nullptr));
  EXPECT_DOUBLE_EQ(residual(0), 10.0);
  EXPECT_NEAR(residual(1), 4.0, 1e-12);
  ExpectJacobiansMatch(*cost, {image, global}, 1e-3, 1e-9);
}

}  // namespace
}  // namespace mfir
