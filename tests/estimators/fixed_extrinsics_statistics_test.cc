#include "src/estimators/fixed_extrinsics_solver.h"

#include <cmath>

#include <ceres/ceres.h>
#include <gtest/gtest.h>

#include "src/residuals/noise_samples.h"
#include "tests/support/test_scenes.h"

namespace mfir {
namespace {

// The first tracks of the first frame take the place of those of the others,
// with errors of their keypoints (px) on top.
void RepeatFirstTracks(size_t num_tracks,
                       double jitter,
                       uint64_t seed,
                       SceneEstimate* scene) {
  Random random({seed});
  const Frame first = scene->scene.frames[0];
  const std::vector<Eigen::Vector3d> points = scene->estimate.frames[0].points;
  const size_t num_observations = first.track_begins[num_tracks];
  for (size_t f = 0; f < scene->scene.frames.size(); ++f) {
    Frame& frame = scene->scene.frames[f];
    ASSERT_EQ(frame.track_begins[num_tracks], num_observations);
    for (size_t i = 0; i < num_tracks; ++i) {
      scene->estimate.frames[f].points[i] = points[i];
    }
    for (size_t k = 0; k < num_observations; ++k) {
      frame.observations[k] = first.observations[k];
      frame.observations[k].xy += Eigen::Vector2d(random.Normal(0.0, jitter),
                                                  random.Normal(0.0, jitter));
    }
  }
}

// J^T J of Ceres at the solution against the sandwich.
TEST(FixedExtrinsicsStatistics, CovarianceIsThatOfCeresOnAverage) {
  constexpr int kNumSeeds = 8;
  constexpr double kNoise = 0.5;
  double sum = 0.0;
  double count = 0.0;
  for (uint64_t seed = 0; seed < kNumSeeds; ++seed) {
    TestSceneOptions scene_options;
    scene_options.num_cameras = 6;
    scene_options.num_frames = 1;
    scene_options.noise = kNoise;
    scene_options.seed = 20 + seed;
    SceneEstimate scene = MakeTestScene(scene_options).start;
    FixedExtrinsicsOptions options = OptionsWithLoss(&kTrivialLoss);
    options.compute_covariance = true;
    const FixedExtrinsicsSummary summary = Solve(options, &scene);

    ceres::Problem problem(SharedLoss());
    AddReprojectionErrors(nullptr, &scene, &problem);
    ceres::Covariance::Options covariance_options;
    covariance_options.algorithm_type = ceres::SPARSE_QR;
    ceres::Covariance covariance(covariance_options);
    std::vector<std::pair<const double*, const double*>> blocks;
    for (const RigCamera& camera : scene.estimate.cameras) {
      blocks.emplace_back(camera.params.data(), camera.params.data());
    }
    ASSERT_TRUE(covariance.Compute(blocks, &problem));
    for (size_t i = 0; i < scene.estimate.cameras.size(); ++i) {
      const double* params = scene.estimate.cameras[i].params.data();
      Eigen::Matrix<double, 4, 4, Eigen::RowMajor> expected;
      covariance.GetCovarianceBlock(params, params, expected.data());
      for (Eigen::Index j = 0; j < 4; ++j) {
        const Eigen::Index row = static_cast<Eigen::Index>(4 * i) + j;
        const double ratio =
            summary.covariance(row, row) / (kNoise * kNoise * expected(j, j));
        EXPECT_GT(ratio, 0.3);
        EXPECT_LT(ratio, 3.0);
        sum += ratio;
        count += 1.0;
      }
    }
  }
  EXPECT_NEAR(sum / count, 1.0, 0.2);
}

TEST(FixedExtrinsicsStatistics, ErrorsAreOfTheSizeThatTheCovarianceTells) {
  for (const bool outliers : {false, true}) {
    double sum = 0.0;
    double count = 0.0;
    for (uint64_t seed = 0; seed < 20; ++seed) {
      TestSceneOptions scene_options;
      scene_options.num_points = 150;
      scene_options.seed = 100 + seed;
      scene_options.outlier_share = outliers ? 0.05 : 0.0;
      scene_options.start_error = 0.3;
      TestScene scene = MakeTestScene(scene_options);
      const ceres::CauchyLoss cauchy(1.0);
      FixedExtrinsicsOptions options = OptionsWithLoss(
          outliers ? static_cast<const ceres::LossFunction*>(&cauchy)
                   : &kTrivialLoss);
      options.compute_covariance = true;
      const FixedExtrinsicsSummary summary = Solve(options, &scene.start);
      EXPECT_TRUE(summary.converged);
      for (size_t i = 0; i < scene.truth.estimate.cameras.size(); ++i) {
        for (size_t j = 0; j < 4; ++j) {
          const double error = scene.start.estimate.cameras[i].params[j] -
                               scene.truth.estimate.cameras[i].params[j];
          const Eigen::Index row = static_cast<Eigen::Index>(4 * i + j);
          sum += error * error / summary.covariance(row, row);
          count += 1.0;
        }
      }
    }
    EXPECT_GT(sum / count, 0.7) << outliers;
    EXPECT_LT(sum / count, 1.4) << outliers;
  }
}

FixedExtrinsicsOptions CovarianceOptions(
    const std::vector<std::vector<TrackIndex>>& repeated_tracks) {
  FixedExtrinsicsOptions options = OptionsWithLoss(&kTrivialLoss);
  options.compute_covariance = true;
  options.repeated_tracks = repeated_tracks;
  return options;
}

Eigen::VectorXd Stds(const FixedExtrinsicsOptions& options,
                     SceneEstimate scene) {
  return Solve(options, &scene).covariance.diagonal().cwiseSqrt();
}

double MaxRelativeDifference(const Eigen::VectorXd& a,
                             const Eigen::VectorXd& b) {
  return (a.cwiseQuotient(b).array() - 1.0).abs().maxCoeff();
}

TEST(FixedExtrinsicsStatistics, RepeatedTracksAreOnePieceOfEvidence) {
  constexpr size_t kNumCopies = 3;
  TestSceneOptions scene_options;
  scene_options.num_frames = 1;
  scene_options.num_points = 200;
  const SceneEstimate one = MakeTestScene(scene_options).start;
  SceneEstimate copies = one;
  copies.scene.frames.assign(kNumCopies, one.scene.frames[0]);
  copies.estimate.frames.assign(kNumCopies, one.estimate.frames[0]);
  std::vector<std::vector<TrackIndex>> all;
  for (size_t i = 0; i < one.scene.frames[0].NumPoints(); ++i) {
    all.push_back({{0, i}, {1, i}, {2, i}});
  }
  const Eigen::VectorXd expected = Stds(CovarianceOptions({}), one);
  const Eigen::VectorXd grouped = Stds(CovarianceOptions(all), copies);
  EXPECT_LT(MaxRelativeDifference(grouped, expected), 1e-7);
  const Eigen::VectorXd independent = Stds(CovarianceOptions({}), copies);
  EXPECT_LT(
      MaxRelativeDifference(std::sqrt(kNumCopies) * independent, expected),
      1e-7);
  // Groups of one are independent tracks, whatever their order.
  std::vector<std::vector<TrackIndex>> single;
  for (size_t f = kNumCopies; f-- > 0;) {
    for (size_t i = 0; i < one.scene.frames[0].NumPoints(); ++i) {
      single.push_back({{f, i}});
    }
  }
  EXPECT_LT(MaxRelativeDifference(Stds(CovarianceOptions(single), copies),
                                  independent),
            1e-7);
}

// Frames that repeat the keypoints of points with a small error of their own,
// and points of their own: neither all nor none of the errors are common.
TEST(FixedExtrinsicsStatistics, ErrorsWithRepeatedTracksToo) {
  constexpr size_t kNumFrames = 4;
  constexpr size_t kNumRepeated = 60;
  double grouped = 0.0;
  double independent = 0.0;
  double count = 0.0;
  for (uint64_t seed = 0; seed < 20; ++seed) {
    TestSceneOptions scene_options;
    scene_options.num_frames = kNumFrames;
    scene_options.num_points = 90;
    scene_options.seed = 300 + seed;
    const TestScene setup = MakeTestScene(scene_options);
    SceneEstimate scene = setup.start;
    std::vector<std::vector<TrackIndex>> repeated(kNumRepeated);
    RepeatFirstTracks(kNumRepeated, 0.1, seed, &scene);
    for (size_t f = 0; f < kNumFrames; ++f) {
      for (size_t i = 0; i < kNumRepeated; ++i) repeated[i].push_back({f, i});
    }
    const Eigen::VectorXd independent_stds = Stds(CovarianceOptions({}), scene);
    const FixedExtrinsicsSummary summary =
        Solve(CovarianceOptions(repeated), &scene);
    for (size_t i = 0; i < scene.estimate.cameras.size(); ++i) {
      for (size_t j = 0; j < 4; ++j) {
        const double error = scene.estimate.cameras[i].params[j] -
                             setup.truth.estimate.cameras[i].params[j];
        const Eigen::Index row = static_cast<Eigen::Index>(4 * i + j);
        grouped += error * error / summary.covariance(row, row);
        independent += std::pow(error / independent_stds(row), 2.0);
        count += 1.0;
      }
    }
  }
  EXPECT_GT(grouped / count, 0.7);
  EXPECT_LT(grouped / count, 1.4);
  EXPECT_GT(independent / count, 1.8);
}

class TrackLengthTest : public testing::TestWithParam<size_t> {};

INSTANTIATE_TEST_SUITE_P(Views, TrackLengthTest, testing::Values(2, 3, 10));

TEST_P(TrackLengthTest, NoiseSamplesHaveTheSigmaOfTheNoise) {
  TestSceneOptions scene_options;
  scene_options.num_cameras = 10;
  scene_options.track_length = GetParam();
  scene_options.num_points = 12000 / GetParam();
  scene_options.noise = 0.5;
  SceneEstimate scene = MakeTestScene(scene_options).start;
  EXPECT_TRUE(Solve(OptionsWithLoss(&kTrivialLoss), &scene).converged);
  for (const bool robust : {false, true}) {
    const ceres::CauchyLoss cauchy(2.385 * scene_options.noise);
    const std::vector<NoiseSample> samples =
        NoiseSamples(
            scene.scene, scene.estimate, robust ? &cauchy : nullptr, nullptr)
            .keypoints;
    double degrees_of_freedom = 0.0;
    double sum = 0.0;
    for (const NoiseSample& sample : samples) {
      ASSERT_GE(sample.squared, 0.0);
      ASSERT_GT(sample.weight, 0.0);
      ASSERT_LE(sample.weight, 1.0);
      degrees_of_freedom += sample.weight;
      sum += sample.weight * sample.squared;
    }
    if (!robust) {
      const double expected = (2.0 * GetParam() - 3.0) *
                              static_cast<double>(scene.scene.frames.size()) *
                              static_cast<double>(scene_options.num_points);
      EXPECT_LE(degrees_of_freedom, expected * (1.0 + 1e-9));
      EXPECT_GT(degrees_of_freedom, 0.9 * expected);
      EXPECT_NEAR(std::sqrt(sum / degrees_of_freedom), 0.5, 0.015);
    }
    EXPECT_NEAR(RobustStd(samples), 0.5, 0.025) << "robust: " << robust;
  }
}

TEST(RobustStd, IsThatOfTheWeightedMedian) {
  EXPECT_EQ(RobustStd({}), 0.0);
  // Median of squares of a standard normal variable: 0.4549.
  EXPECT_NEAR(RobustStd({{4.0 * 0.45493642, 1.0}}), 2.0, 1e-8);
  EXPECT_NEAR(
      RobustStd({{1e9, 0.4}, {0.45493642, 0.5}, {0.0, 0.05}}), 1.0, 1e-8);
}

}  // namespace
}  // namespace mfir
