// Poses that survive COLMAP's files bit for bit.

#include "colmap_ext/host/compat.h"

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

TEST(StableQuaternion, NormalizationChangesNothing) {
  std::mt19937 random(1);
  double max_change = 0.0;
  int num_unstable = 0;
  for (int i = 0; i < 100000; ++i) {
    const Eigen::Quaterniond q = RandomRotation(&random);
    const Eigen::Vector4d given(q.w(), q.x(), q.y(), q.z());
    const Eigen::Quaterniond stable = StableQuaternion(q);
    const Eigen::Vector4d qvec(stable.w(), stable.x(), stable.y(), stable.z());
    num_unstable += colmap::NormalizeQuaternion(qvec) != qvec;
    max_change = std::max(max_change, (qvec - given).cwiseAbs().maxCoeff());
    if (colmap::NormalizeQuaternion(given) == given) {
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
      const Eigen::Quaterniond stable = StableQuaternion(q);
      EXPECT_EQ(StableQuaternion(stable).coeffs(), stable.coeffs());
      EXPECT_LE((stable.coeffs() - q.coeffs()).cwiseAbs().maxCoeff(), 2.3e-16);
    }
  }
}

// Through COLMAP's own writers and readers, twice.
TEST(StableQuaternion, SurvivesFiles) {
  const TemporaryFolder folder;
  std::mt19937 random(2);
  colmap::Reconstruction model;
  colmap::Camera camera;
  camera.SetCameraId(1);
  camera.InitializeWithName("PINHOLE", 500, 640, 480);
  model.AddCamera(camera);
  const int kNumImages = 2000;
  for (int i = 1; i <= kNumImages; ++i) {
    colmap::Image image;
    image.SetImageId(i);
    image.SetCameraId(1);
    image.SetName(std::to_string(i));
    SetCamFromWorld({StableQuaternion(RandomRotation(&random)),
                     1e3 * Eigen::Vector3d(RandomRotation(&random).vec())},
                    &image);
    model.AddImage(image);
    model.RegisterImage(i);
  }
  model.WriteText(folder.Path());
  colmap::Reconstruction from_text;
  from_text.ReadText(folder.Path());
  from_text.WriteBinary(folder.Path());
  colmap::Reconstruction from_binary;
  from_binary.ReadBinary(folder.Path());
  for (const colmap::Reconstruction* read : {&from_text, &from_binary}) {
    ASSERT_EQ(read->NumRegImages(), static_cast<size_t>(kNumImages));
    for (int i = 1; i <= kNumImages; ++i) {
      EXPECT_EQ(read->Image(i).Qvec(), model.Image(i).Qvec()) << i;
      EXPECT_EQ(read->Image(i).Tvec(), model.Image(i).Tvec()) << i;
    }
  }
}

}  // namespace
}  // namespace mfir
