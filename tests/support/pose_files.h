// Poses as files in other conventions have them.

#pragma once

#include <vector>

#include <gtest/gtest.h>

#include "src/geometry/pose_conventions.h"

namespace mfir {

// x_file = F (R M x_world + t), where the world is mirrored by M.
inline Rigid3 InConvention(const PoseConvention& convention,
                           const Rigid3& pose) {
  const Eigen::Vector3d& F = convention.axes;
  Eigen::Matrix3d R = F.asDiagonal() * pose.rotation.toRotationMatrix();
  if (F.prod() < 0.0) R = R * Eigen::Vector3d(1, 1, -1).asDiagonal();
  EXPECT_NEAR(R.determinant(), 1.0, 1e-9);
  const Eigen::Vector3d t = F.cwiseProduct(pose.translation);
  if (!convention.is_camera_to_world) return {Eigen::Quaterniond(R), t};
  return {Eigen::Quaterniond(R.transpose()), -R.transpose() * t};
}

inline std::vector<Rigid3> InConvention(const PoseConvention& convention,
                                        const std::vector<Rigid3>& poses) {
  std::vector<Rigid3> converted;
  for (const Rigid3& pose : poses) {
    converted.push_back(InConvention(convention, pose));
  }
  return converted;
}

}  // namespace mfir
