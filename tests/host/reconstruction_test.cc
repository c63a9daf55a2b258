// Poses that survive COLMAP's files bit for bit.

#include "colmap_ext/host/reconstruction.h"

#include <random>

#include <gtest/gtest.h>

#include "tests/support/test_files.h"

namespace mfir {
namespace {

Eigen::Quaterniond RandomRotation(std::mt19937* random) {
  std::normal_distribution<double> normal;
  // One by one: the order of arguments is not defined.
  Eigen::Quaterniond q;
  for (int i = 0; i < 4; ++i) q.coeffs()(i) = normal(*random);
  return q.normalized();
}

// As COLMAP 3.8 does when it reads or writes a quaternion.
Eigen::Vector4d Normalized(const Eigen::Vector4d& qvec) {
  return qvec / qvec.norm();
}

TEST(StableQuaternion, NormalizationChangesNothing) {
  std::mt19937 random(1);
  double max_change = 0.0;
  int num_unstable = 0;
  for (int i = 0; i < 100000; ++i) {
    const Eigen::Quaterniond q = RandomRotation(&random);
    const Eigen::Vector4d given(q.w(), q.x(), q.y(), q.z());
    const Eigen::Quaterniond stable = host::StableQuaternion(q);
    const Eigen::Vector4d qvec(stable.w(), stable.x(), stable.y(), stable.z());
    num_unstable += Normalized(qvec) != qvec;
    max_change = std::max(max_change, (qvec - given).cwiseAbs().maxCoeff());
    if (Normalized(given) == given) {
      ASSERT_EQ(qvec, given);
    }
  }
  EXPECT_EQ(num_unstable, 0);
  // Four units in the last place of a component above 0.5.
  EXPECT_LE(max_change, 4.5e-16);
}

TEST(StableQuaternion, RotationsAboutAxes) {
  for (const double angle : {0.0, 1e-300, 1e-9, 0.1, M_PI_2, M_PI}) {
    for (int axis = 0; axis < 3; ++axis) {
      const Eigen::Quaterniond q(
          Eigen::AngleAxisd(angle, Eigen::Vector3d::Unit(axis)));
      const Eigen::Quaterniond stable = host::StableQuaternion(q);
      EXPECT_EQ(host::StableQuaternion(stable).coeffs(), stable.coeffs());
      EXPECT_LE((stable.coeffs() - q.coeffs()).cwiseAbs().maxCoeff(), 2.3e-16);
    }
  }
}

// Through COLMAP's own writers and readers, twice.
TEST(StableQuaternion, SurvivesFiles) {
  const TemporaryFolder folder;
  std::mt19937 random(2);
  host::Reconstruction model;
  host::AddCameraWithTrivialRig(
      host::MakeCamera(1, /*model_id=*/1, 640, 480, {500, 500, 320, 240}),
      &model);
  const int kNumImages = 2000;
  for (int i = 1; i <= kNumImages; ++i) {
    host::Image image;
    image.SetImageId(i);
    image.SetCameraId(1);
    image.SetName(std::to_string(i));
    host::AddImageWithTrivialFrame(
        image,
        {host::StableQuaternion(RandomRotation(&random)),
         1e3 * Eigen::Vector3d(RandomRotation(&random).vec())},
        &model);
  }
  model.WriteText(folder.Path());
  host::Reconstruction from_text;
  host::ReadReconstruction(folder.Path(), /*is_binary=*/false, &from_text);
  from_text.WriteBinary(folder.Path());
  host::Reconstruction from_binary;
  host::ReadReconstruction(folder.Path(), /*is_binary=*/true, &from_binary);
  for (const host::Reconstruction* read : {&from_text, &from_binary}) {
    ASSERT_EQ(read->NumRegImages(), static_cast<size_t>(kNumImages));
    for (int i = 1; i <= kNumImages; ++i) {
      const Rigid3 pose = host::CamFromWorld(read->Image(i));
      const Rigid3 written = host::CamFromWorld(model.Image(i));
      EXPECT_EQ(pose.rotation.coeffs(), written.rotation.coeffs()) << i;
      EXPECT_EQ(pose.translation, written.translation) << i;
    }
  }
}

}  // namespace
}  // namespace mfir
