#include "src/geometry/pose_conventions.h"

#include <algorithm>

#include "src/geometry/alignment.h"

namespace mfir {
namespace {

// Of the median pose error, see PoseAlignment. Poses of a reconstruction with
// wrong intrinsics are off by a few percent; below the first limit RIG is right
// as it is, or the conventions cannot be told apart.
constexpr double kMaxErrorOfRightPoses = 0.02;
constexpr double kMaxErrorOfConvertedPoses = 0.15;
constexpr double kMinErrorRatio = 3.0;
// Where errors of conventions differ by less than this factor, or are below
// this error, the more usual one is taken.
constexpr double kSameErrorRatio = 1.5;
constexpr double kNoError = 1e-3;
// More cameras only take longer.
constexpr size_t kMaxNumPoses = 30;

const char* const kAxisNames[] = {"x", "y", "z"};

std::string TurnedAxes(const Eigen::Vector3d& axes) {
  std::vector<std::string> names;
  for (int i = 0; i < 3; ++i) {
    if (axes(i) < 0.0) names.push_back(kAxisNames[i]);
  }
  if (names.size() == 1) return "axis " + names[0] + " turned";
  if (names.size() == 2)
    return "axes " + names[0] + " and " + names[1] + " turned";
  return "axes all turned";
}

std::string Diagonal(const Eigen::Vector3d& axes) {
  std::string text;
  for (int i = 0; i < 3; ++i) {
    text += std::string(i == 0 ? "" : ", ") + (axes(i) < 0.0 ? "-1" : "1");
  }
  return "diag(" + text + ")";
}

std::vector<PoseConvention> MakeOtherPoseConventions() {
  std::vector<PoseConvention> conventions;
  for (const Eigen::Vector3d& axes : {Eigen::Vector3d(1, 1, 1),
                                      Eigen::Vector3d(1, -1, -1),
                                      Eigen::Vector3d(-1, -1, 1),
                                      Eigen::Vector3d(-1, 1, -1),
                                      Eigen::Vector3d(1, -1, 1),
                                      Eigen::Vector3d(-1, 1, 1),
                                      Eigen::Vector3d(1, 1, -1),
                                      Eigen::Vector3d(-1, -1, -1)}) {
    for (const bool is_camera_to_world : {false, true}) {
      if (is_camera_to_world || axes != Eigen::Vector3d::Ones()) {
        conventions.push_back({is_camera_to_world, axes});
      }
    }
  }
  return conventions;
}

std::vector<Rigid3> SomePoses(const std::vector<Rigid3>& poses) {
  const size_t num = std::min(poses.size(), kMaxNumPoses);
  std::vector<Rigid3> some;
  for (size_t i = 0; i < num; ++i) {
    some.push_back(poses[i * poses.size() / num]);
  }
  return some;
}

}  // namespace

Rigid3 PoseConvention::ToColmap(const Rigid3& pose) const {
  Eigen::Matrix3d R = pose.rotation.normalized().toRotationMatrix();
  Eigen::Vector3d t = pose.translation;
  if (is_camera_to_world) {
    R.transposeInPlace();
    t = -(R * t);
  }
  R = axes.asDiagonal() * R;
  t = axes.cwiseProduct(t);
  if (IsMirrored()) R.col(2) *= -1.0;
  Rigid3 converted;
  converted.rotation = Eigen::Quaterniond(R).normalized();
  converted.translation = t;
  return converted;
}

std::string PoseConvention::Description() const {
  std::string text = is_camera_to_world ? "camera-to-world" : "world-to-camera";
  text += " poses";
  if (IsMirrored()) text += " in a mirrored (left-handed) world";
  if (axes == Eigen::Vector3d(1, -1, -1)) {
    text += " with OpenGL's camera axes (y up, z backward)";
  } else if (axes != Eigen::Vector3d::Ones()) {
    text += " with the camera's " + TurnedAxes(axes);
  }
  return text;
}

std::string PoseConvention::Formula() const {
  const bool turned = axes != Eigen::Vector3d::Ones();
  const std::string R =
      std::string(turned ? "F " : "") + (is_camera_to_world ? "R^T" : "R");
  const std::string t = is_camera_to_world ? "-" + R + " t" : "F t";
  return "R' = " + R + (IsMirrored() ? " M" : "") + ", t' = " + t +
         (turned ? " with F = " + Diagonal(axes) : "") +
         (IsMirrored() ? ", M = diag(1, 1, -1)" : "");
}

const std::vector<PoseConvention>& OtherPoseConventions() {
  static const std::vector<PoseConvention> conventions =
      MakeOtherPoseConventions();
  return conventions;
}

const PoseConvention* FindPoseConvention(
    const std::vector<Rigid3>& cams_from_world,
    const std::vector<Rigid3>& rig_cams_from_world) {
  const std::vector<Rigid3> source = SomePoses(cams_from_world);
  const std::vector<Rigid3> target = SomePoses(rig_cams_from_world);
  const double error_as_given = AlignPoses(source, target).median_error;
  if (error_as_given < kMaxErrorOfRightPoses) return nullptr;
  const double max_error =
      std::min(kMaxErrorOfConvertedPoses, error_as_given / kMinErrorRatio);
  const PoseConvention* best = nullptr;
  double best_error = 0.0;
  for (const PoseConvention& convention : OtherPoseConventions()) {
    std::vector<Rigid3> converted;
    for (const Rigid3& pose : target) {
      converted.push_back(convention.ToColmap(pose));
    }
    const double error =
        std::max(kNoError, AlignPoses(source, converted).median_error);
    if (error < max_error &&
        (best == nullptr || error * kSameErrorRatio < best_error)) {
      best = &convention;
      best_error = error;
    }
  }
  return best;
}

std::string PoseConventionAdvice(const PoseConvention& convention) {
  return "RIG seems to hold " + convention.Description() +
         ". Convert each pose to COLMAP's, world-to-camera (x_camera = R "
         "x_world + t) with the camera axes x right, y down, z forward: " +
         convention.Formula() + ".";
}

}  // namespace mfir
