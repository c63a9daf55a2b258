#include "src/geometry/epipolar_tolerance.h"

#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "tests/support/test_scenes.h"

namespace mfir {
namespace {

constexpr double kMaxError = 20.0;
// Share of wrong matches within 20 pixels of the line: 40 of 400 pixels.
constexpr double kShare = 0.1;

// Right matches have errors |bias + N(0, sigma)|, wrong ones are uniform such
// that kShare of them lies within kMaxError.
std::vector<double> Errors(size_t num_right,
                           double bias,
                           double sigma,
                           size_t num_wrong,
                           uint64_t seed) {
  Random random({seed});
  std::vector<double> errors;
  for (size_t i = 0; i < num_right; ++i) {
    errors.push_back(std::abs(random.Normal(bias, sigma)));
  }
  for (size_t i = 0; i < num_wrong; ++i) {
    errors.push_back(random.Uniform(0.0, kMaxError / kShare));
  }
  return errors;
}

EpipolarTolerance Estimate(const std::vector<double>& errors) {
  return EstimateEpipolarTolerance(errors, kShare, 1.0, kMaxError);
}

TEST(EpipolarError, IsZeroOnTheLineAndGrowsByPixels) {
  Random random({1});
  for (int i = 0; i < 50; ++i) {
    const Rigid3 pose1{RandomRotation(&random), RandomVector(&random)};
    const Rigid3 pose2{RandomRotation(&random), RandomVector(&random)};
    const Eigen::Matrix3d E = EssentialMatrix(pose1, pose2);
    const Eigen::Vector3d x = RandomVector(&random, 3.0);
    const Eigen::Vector3d ray1 = (pose1 * x).normalized();
    const Eigen::Vector3d ray2 = (pose2 * x).normalized();
    EXPECT_LT(EpipolarError(E, ray1, ray2, 1000.0, 500.0), 1e-9);
    // Turned out of the epipolar plane by 2 pixels in image 2. The other image
    // takes a share of the displacement, more if its pixels are finer.
    const Eigen::Vector3d normal = (E * ray1).normalized();
    const double angle = 2.0 / 500.0;
    const Eigen::Vector3d moved =
        std::cos(angle) * ray2 + std::sin(angle) * normal;
    const double error = EpipolarError(E, ray1, moved, 1e9, 500.0);
    EXPECT_NEAR(error, 2.0, 0.01);
    EXPECT_LT(EpipolarError(E, ray1, moved, 500.0, 500.0), error);
  }
}

TEST(EpipolarError, UnitsOfTheWorldDoNotMatter) {
  Random random({2});
  const Rigid3 pose1{RandomRotation(&random), RandomVector(&random)};
  const Rigid3 pose2{RandomRotation(&random), RandomVector(&random)};
  const auto scaled = [](Rigid3 pose) {
    pose.translation *= 1000.0;
    return pose;
  };
  EXPECT_LT((EssentialMatrix(pose1, pose2) -
             EssentialMatrix(scaled(pose1), scaled(pose2)))
                .norm(),
            1e-12);
}

TEST(EpipolarTolerance, FollowsTheSpreadOfTheRightMatches) {
  for (const double sigma : {1.0, 2.0, 4.0}) {
    const EpipolarTolerance result = Estimate(Errors(200, 0.0, sigma, 200, 3));
    EXPECT_GT(result.tolerance, 1.7 * sigma);
    EXPECT_LT(result.tolerance, 5.0 * sigma);
    EXPECT_LT(result.log_nfa, -100.0);
  }
}

TEST(EpipolarTolerance, CoversADriftOfOneSign) {
  // Wrong principal points move all lines: errors of 7 pixels, none near 0.
  const std::vector<double> errors = Errors(100, 7.0, 0.5, 100, 4);
  const EpipolarTolerance result = Estimate(errors);
  const size_t num_covered =
      std::count_if(errors.begin(), errors.begin() + 100, [&](double error) {
        return error <= result.tolerance;
      });
  EXPECT_GE(num_covered, 99);
  EXPECT_LT(result.tolerance, 14.0);
}

TEST(EpipolarTolerance, HoldsWithNineOfTenMatchesWrong) {
  const EpipolarTolerance result = Estimate(Errors(40, 0.0, 1.0, 360, 5));
  EXPECT_LT(result.tolerance, 5.0);
  EXPECT_LT(result.log_nfa, -20.0);
}

TEST(EpipolarTolerance, WrongMatchesOnlyAreNoSurprise) {
  for (uint64_t seed = 10; seed < 110; ++seed) {
    const EpipolarTolerance result = Estimate(Errors(0, 0.0, 1.0, 200, seed));
    EXPECT_GT(result.log_nfa, -8.0) << seed;
  }
}

TEST(EpipolarTolerance, StaysWithinCapAndFloor) {
  // All within a hundredth of a pixel: the floor, widened.
  EXPECT_NEAR(Estimate(Errors(100, 0.0, 0.01, 0, 6)).tolerance, 1.5, 1e-12);
  EXPECT_EQ(Estimate(Errors(300, 15.0, 4.0, 0, 7)).tolerance, kMaxError);
  const EpipolarTolerance none = Estimate({});
  EXPECT_EQ(none.num_inliers, 0);
  EXPECT_EQ(none.log_nfa, 0.0);
}

TEST(LogNumFalseAlarms, IsTheBinomialCoefficientTimesTheProbability) {
  // C(5, 2) * (0.1 * 4 / 20)^2.
  EXPECT_NEAR(LogNumFalseAlarms(5, 2, 4.0, kShare, kMaxError),
              std::log(10.0 * 0.02 * 0.02),
              1e-12);
}

}  // namespace
}  // namespace mfir
