#include "src/geometry/pose_conventions.h"

#include <gtest/gtest.h>

#include "src/geometry/alignment.h"
#include "tests/support/pose_files.h"
#include "tests/support/test_scenes.h"

namespace mfir {
namespace {

// As a reconstruction gives them: coordinates of its own, a little wrong.
std::vector<Rigid3> Reconstructed(const std::vector<Rigid3>& poses,
                                  double error,
                                  uint64_t seed) {
  Random random({seed});
  Similarity3 gauge;
  gauge.scale = random.Uniform(0.01, 100.0);
  gauge.rotation = RandomRotation(&random);
  gauge.translation = RandomVector(&random, 50.0);
  std::vector<Rigid3> reconstructed;
  for (Rigid3 pose : poses) {
    const Eigen::Vector3d axis = RandomVector(&random).normalized();
    pose.rotation = Eigen::AngleAxisd(error, axis) * pose.rotation;
    pose.translation += RandomVector(&random, error);
    reconstructed.push_back(TransformPose(gauge, pose));
  }
  return reconstructed;
}

// Cameras on an arc around the object, upright, up to `elevation` (rad) above
// or below its plane.
std::vector<Rigid3> ArcPoses(size_t num, double elevation) {
  std::vector<Rigid3> poses;
  for (size_t i = 0; i < num; ++i) {
    const double azimuth = -1.0 + 2.0 * i / (num - 1);
    const Eigen::Vector3d center =
        3.0 * Eigen::Vector3d(std::sin(azimuth),
                              std::sin(elevation * (int(i % 3) - 1)),
                              -std::cos(azimuth));
    Eigen::Matrix3d R;
    R.row(2) = -center.normalized();
    R.row(0) = Eigen::Vector3d::UnitY().cross(R.row(2)).normalized();
    R.row(1) = R.row(2).cross(R.row(0));
    poses.push_back({Eigen::Quaterniond(R), -R * center});
  }
  return poses;
}

TEST(PoseConvention, ToColmapUndoesTheConvention) {
  EXPECT_EQ(OtherPoseConventions().size(), 15);
  for (const PoseConvention& convention : OtherPoseConventions()) {
    for (const Rigid3& pose : DomePoses(5, 1)) {
      const Rigid3 converted =
          convention.ToColmap(InConvention(convention, pose));
      EXPECT_LT(converted.rotation.angularDistance(pose.rotation), 1e-7);
      EXPECT_LT((converted.translation - pose.translation).norm(), 1e-12);
    }
  }
}

TEST(PoseConvention, DescriptionAndFormula) {
  const PoseConvention inverse = {true, {1, 1, 1}};
  EXPECT_EQ(inverse.Description(), "camera-to-world poses");
  EXPECT_EQ(inverse.Formula(), "R' = R^T, t' = -R^T t");
  const PoseConvention opengl = {false, {1, -1, -1}};
  EXPECT_EQ(
      opengl.Description(),
      "world-to-camera poses with OpenGL's camera axes (y up, z backward)");
  EXPECT_EQ(opengl.Formula(), "R' = F R, t' = F t with F = diag(1, -1, -1)");
  const PoseConvention both = {true, {1, -1, -1}};
  EXPECT_EQ(both.Formula(),
            "R' = F R^T, t' = -F R^T t with F = diag(1, -1, -1)");
  const PoseConvention mirrored = {true, {1, -1, 1}};
  EXPECT_EQ(mirrored.Description(),
            "camera-to-world poses in a mirrored (left-handed) world with the "
            "camera's axis y turned");
  EXPECT_EQ(mirrored.Formula(),
            "R' = F R^T M, t' = -F R^T t with F = diag(1, -1, 1), M = "
            "diag(1, 1, -1)");
}

TEST(FindPoseConvention, RecognisesEach) {
  for (const size_t num_cameras : {6, 12, 80}) {
    const std::vector<Rigid3> poses = DomePoses(num_cameras, 2);
    for (const double error : {0.0, 0.03}) {
      const std::vector<Rigid3> frame = Reconstructed(poses, error, 3);
      EXPECT_EQ(FindPoseConvention(frame, poses), nullptr);
      for (const PoseConvention& convention : OtherPoseConventions()) {
        EXPECT_EQ(FindPoseConvention(frame, InConvention(convention, poses)),
                  &convention)
            << num_cameras << " " << error << " " << convention.Description();
      }
    }
  }
}

TEST(FindPoseConvention, SomeWrongPosesDoNotMatter) {
  const std::vector<Rigid3> poses = DomePoses(12, 4);
  std::vector<Rigid3> frame = Reconstructed(poses, 0.01, 5);
  for (const size_t i : {1, 5, 6, 10}) frame[i] = frame[0];
  EXPECT_EQ(FindPoseConvention(frame, poses), nullptr);
  for (const PoseConvention& convention : OtherPoseConventions()) {
    EXPECT_EQ(FindPoseConvention(frame, InConvention(convention, poses)),
              &convention);
  }
}

// Their mirror image passes the alignment: only the comparison tells.
TEST(FindPoseConvention, NearlyPlanarArrays) {
  const PoseConvention mirrored = {false, {1, -1, 1}};
  for (const double elevation : {0.08, 0.15, 0.2}) {
    const std::vector<Rigid3> poses = ArcPoses(9, elevation);
    const std::vector<Rigid3> frame = Reconstructed(poses, 0.01, 6);
    const std::vector<Rigid3> rig = InConvention(mirrored, poses);
    EXPECT_EQ(AlignPoses(frame, rig).failure, "");
    const PoseConvention* found = FindPoseConvention(frame, rig);
    ASSERT_NE(found, nullptr) << elevation;
    EXPECT_EQ(found->Description(), mirrored.Description());
    EXPECT_EQ(FindPoseConvention(frame, poses), nullptr);
  }
  // In a plane the mirror image is the array itself.
  const std::vector<Rigid3> poses = ArcPoses(9, 0.0);
  EXPECT_EQ(FindPoseConvention(Reconstructed(poses, 0.01, 6),
                               InConvention(mirrored, poses)),
            nullptr);
}

TEST(FindPoseConvention, NoneForRightOrUnrelatedPoses) {
  for (uint64_t seed = 0; seed < 50; ++seed) {
    const size_t num_cameras = 4 + seed % 20;
    const std::vector<Rigid3> poses = DomePoses(num_cameras, seed);
    for (const double error : {0.0, 0.02, 0.1, 0.3}) {
      EXPECT_EQ(FindPoseConvention(Reconstructed(poses, error, seed), poses),
                nullptr)
          << seed << " " << error;
    }
    EXPECT_EQ(FindPoseConvention(Reconstructed(poses, 0.0, seed),
                                 DomePoses(num_cameras, seed + 1000)),
              nullptr)
        << seed;
  }
}

}  // namespace
}  // namespace mfir
