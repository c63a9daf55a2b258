#include "src/geometry/alignment.h"

#include <gtest/gtest.h>

#include "tests/support/test_scenes.h"

namespace mfir {
namespace {

Similarity3 RandomSimilarity(Random* random) {
  Similarity3 similarity;
  similarity.scale = random->Uniform(0.01, 100.0);
  similarity.rotation = RandomRotation(random);
  similarity.translation = RandomVector(random, 50.0);
  return similarity;
}

Rigid3 RandomPose(Random* random) {
  Rigid3 pose;
  pose.rotation = RandomRotation(random);
  pose.translation = RandomVector(random, 3.0);
  return pose;
}

// Poses of the rig as a reconstruction in a gauge of its own would have them.
std::vector<Rigid3> Transformed(const Similarity3& new_from_old,
                                const std::vector<Rigid3>& poses) {
  std::vector<Rigid3> transformed;
  for (const Rigid3& pose : poses) {
    transformed.push_back(TransformPose(new_from_old, pose));
  }
  return transformed;
}

void ExpectNear(const Similarity3& a, const Similarity3& b, double tolerance) {
  EXPECT_NEAR(a.scale / b.scale, 1.0, tolerance);
  EXPECT_LT(a.rotation.angularDistance(b.rotation), std::max(tolerance, 1e-7));
  EXPECT_LT((a.translation - b.translation).norm(),
            tolerance * (1.0 + b.translation.norm()));
}

TEST(Similarity, InverseAndProductAreThoseOfTheMapping) {
  Random random({1});
  for (int i = 0; i < 20; ++i) {
    const Similarity3 b_from_a = RandomSimilarity(&random);
    const Similarity3 c_from_b = RandomSimilarity(&random);
    const Eigen::Vector3d x = RandomVector(&random);
    const double size = (c_from_b * (b_from_a * x)).norm();
    EXPECT_LT((Inverse(b_from_a) * (b_from_a * x) - x).norm(), 1e-9);
    EXPECT_LT(((c_from_b * b_from_a) * x - c_from_b * (b_from_a * x)).norm(),
              1e-12 * size);
    ExpectNear(Inverse(b_from_a) * b_from_a, Similarity3(), 1e-10);
    ExpectNear(Inverse(Inverse(b_from_a)), b_from_a, 1e-12);
  }
}

TEST(Similarity, TransformPoseKeepsProjections) {
  Random random({2});
  for (int i = 0; i < 20; ++i) {
    const Similarity3 new_from_old = RandomSimilarity(&random);
    const Rigid3 pose = RandomPose(&random);
    const Rigid3 new_pose = TransformPose(new_from_old, pose);
    const Eigen::Vector3d x = RandomVector(&random);
    // Camera coordinates are scaled with the world, rays stay.
    EXPECT_LT((new_pose * (new_from_old * x) - new_from_old.scale * (pose * x))
                  .norm(),
              1e-10 * new_from_old.scale);
    EXPECT_LT((new_pose.Center() - new_from_old * pose.Center()).norm(),
              1e-10 * new_from_old.scale);
    EXPECT_NEAR(new_pose.rotation.norm(), 1.0, 1e-15);
  }
}

TEST(NormalizeRig, CentresCamerasAtAnRmsOf1000) {
  std::vector<Rigid3> poses = DomePoses(11, 3);
  Random random({3});
  poses = Transformed(RandomSimilarity(&random), poses);
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  double sum = 0.0;
  for (const Rigid3& pose : Transformed(NormalizeRig(poses), poses)) {
    mean += pose.Center() / 11;
    sum += pose.Center().squaredNorm() / 11;
  }
  EXPECT_LT(mean.norm(), 1e-9);
  EXPECT_NEAR(std::sqrt(sum), 1000.0, 1e-9);
}

TEST(NormalizeRig, OneCameraOrCoincidingOnesStayFinite) {
  const std::vector<Rigid3> poses = DomePoses(1, 3);
  EXPECT_EQ(NormalizeRig(poses).scale, 1.0);
  EXPECT_TRUE(NormalizeRig(poses).translation.allFinite());
}

TEST(AlignPoses, RecoversTheGaugeExactly) {
  Random random({4});
  for (const size_t num_cameras : {3, 4, 12, 60}) {
    const std::vector<Rigid3> target = DomePoses(num_cameras, 4);
    const Similarity3 source_from_target = RandomSimilarity(&random);
    const PoseAlignment alignment =
        AlignPoses(Transformed(source_from_target, target), target);
    ASSERT_EQ(alignment.failure, "");
    EXPECT_EQ(alignment.num_inliers, num_cameras);
    EXPECT_EQ(alignment.inliers, std::vector<bool>(num_cameras, true));
    EXPECT_LT(alignment.rms_center_error, 1e-9);
    ExpectNear(alignment.target_from_source * source_from_target, {}, 1e-9);
  }
}

TEST(AlignPoses, ReportsTheRmsOfTheInliers) {
  const std::vector<Rigid3> target = DomePoses(200, 4);
  std::vector<Rigid3> source = target;
  Random random({14});
  for (Rigid3& pose : source) pose.translation += RandomVector(&random, 0.01);
  const PoseAlignment alignment = AlignPoses(source, target);
  ASSERT_EQ(alignment.failure, "");
  // Three axes of 0.01; the fit of seven of 600 coordinates is nothing.
  EXPECT_NEAR(alignment.rms_center_error, 0.01 * std::sqrt(3.0), 1e-3);
}

class WrongPosesTest
    : public testing::TestWithParam<std::tuple<double, uint64_t>> {};

INSTANTIATE_TEST_SUITE_P(Shares,
                         WrongPosesTest,
                         testing::Combine(testing::Values(0.2, 0.4),
                                          testing::Range<uint64_t>(0, 10)));

TEST_P(WrongPosesTest, AreFoundAndDoNotSpoilTheAlignment) {
  const double share = std::get<0>(GetParam());
  const uint64_t seed = std::get<1>(GetParam());
  const size_t num_cameras = 20;
  Random random({seed, 5});
  const std::vector<Rigid3> target = DomePoses(num_cameras, seed);
  const Similarity3 source_from_target = RandomSimilarity(&random);
  std::vector<Rigid3> source = target;
  std::vector<bool> expected(num_cameras, true);
  for (size_t i = 0; i < share * num_cameras; ++i) {
    source[(7 * i) % num_cameras] = RandomPose(&random);
    expected[(7 * i) % num_cameras] = false;
  }
  source = Transformed(source_from_target, source);
  const PoseAlignment alignment = AlignPoses(source, target);
  ASSERT_EQ(alignment.failure, "");
  EXPECT_EQ(alignment.inliers, expected);
  ExpectNear(alignment.target_from_source * source_from_target, {}, 1e-9);
  EXPECT_LT(alignment.rms_center_error, 1e-9);
}

// The hardest kind of wrong: 40 % of the cameras agree on another gauge.
TEST(AlignPoses, ConsistentMinorityLoses) {
  Random random({6});
  const std::vector<Rigid3> target = DomePoses(20, 6);
  std::vector<Rigid3> source = target;
  const std::vector<Rigid3> other =
      Transformed(RandomSimilarity(&random), target);
  for (size_t i = 0; i < 8; ++i) source[i] = other[i];
  const PoseAlignment alignment = AlignPoses(source, target);
  ASSERT_EQ(alignment.failure, "");
  EXPECT_EQ(alignment.num_inliers, 12u);
  ExpectNear(alignment.target_from_source, {}, 1e-9);
}

// One camera far away must not widen what counts as agreement: its distance is
// that of a real camera of the array, the others are half a metre apart.
TEST(AlignPoses, WrongPoseOfTheOnlyDistantCameraIsAnOutlier) {
  Random random({7});
  const std::vector<Rigid3> target = DomePoses(10, 7);
  std::vector<Rigid3> source = target;
  source[0].translation += Eigen::Vector3d(1e6, 0, 0);
  const PoseAlignment alignment = AlignPoses(source, target);
  ASSERT_EQ(alignment.failure, "");
  EXPECT_EQ(alignment.num_inliers, 9u);
  EXPECT_FALSE(alignment.inliers[0]);
  ExpectNear(alignment.target_from_source, {}, 1e-9);
}

TEST(AlignPoses, CamerasOnALineAlignByTheirRotations) {
  Random random({8});
  std::vector<Rigid3> target = DomePoses(8, 8);
  for (size_t i = 0; i < target.size(); ++i) {
    const Eigen::Vector3d center(static_cast<double>(i), 0.0, 0.0);
    target[i].translation = -(target[i].rotation * center);
  }
  const Similarity3 source_from_target = RandomSimilarity(&random);
  std::vector<Rigid3> source = target;
  source[2] = RandomPose(&random);
  const PoseAlignment alignment =
      AlignPoses(Transformed(source_from_target, source), target);
  ASSERT_EQ(alignment.failure, "");
  EXPECT_EQ(alignment.num_inliers, 7u);
  ExpectNear(alignment.target_from_source * source_from_target, {}, 1e-9);
}

TEST(AlignPoses, QuaternionSignsDoNotMatter) {
  const std::vector<Rigid3> target = DomePoses(10, 9);
  std::vector<Rigid3> source = target;
  for (size_t i = 0; i < source.size(); i += 2) {
    source[i].rotation.coeffs() *= -1.0;
  }
  const PoseAlignment alignment = AlignPoses(source, target);
  EXPECT_EQ(alignment.num_inliers, 10u);
  ExpectNear(alignment.target_from_source, {}, 1e-9);
}

TEST(AlignPoses, FailsWithFewerThanThreeCameras) {
  for (const size_t num_cameras : {0, 1, 2}) {
    const std::vector<Rigid3> poses = DomePoses(num_cameras, 10);
    const std::string failure = AlignPoses(poses, poses).failure;
    EXPECT_NE(failure.find(std::to_string(num_cameras)), std::string::npos);
    EXPECT_NE(failure.find("3 are needed"), std::string::npos) << failure;
  }
}

TEST(AlignPoses, FailsWithOneOfThreeWrong) {
  Random random({11});
  const std::vector<Rigid3> target = DomePoses(3, 11);
  std::vector<Rigid3> source = target;
  source[1] = RandomPose(&random);
  EXPECT_NE(AlignPoses(source, target).failure, "");
}

TEST(AlignPoses, FailsForTheRigOfAnotherArray) {
  for (uint64_t seed = 0; seed < 20; ++seed) {
    const PoseAlignment alignment =
        AlignPoses(DomePoses(12, 100 + seed), [&]() {
          // Another dome: the names belong to other places.
          std::vector<Rigid3> poses = DomePoses(12, 200 + seed);
          Random random({seed, 12});
          for (size_t i = poses.size() - 1; i > 0; --i) {
            std::swap(poses[i], poses[random.Integer(0, i)]);
          }
          return poses;
        }());
    EXPECT_NE(alignment.failure, "")
        << "seed " << seed << ": " << alignment.num_inliers << " inliers";
  }
}

TEST(AlignPoses, FailsWhereAllCentresCoincide) {
  std::vector<Rigid3> poses = DomePoses(5, 13);
  for (Rigid3& pose : poses) pose.translation.setZero();
  EXPECT_NE(AlignPoses(poses, poses).failure, "");
  // Only the reconstruction is degenerate.
  EXPECT_NE(AlignPoses(poses, DomePoses(5, 13)).failure, "");
}

}  // namespace
}  // namespace mfir
