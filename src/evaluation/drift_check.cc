#include "src/evaluation/drift_check.h"

#include <algorithm>
#include <cmath>

#include "src/evaluation/extrinsics_check.h"
#include "src/scene/residual_statistics.h"
#include "src/util/median.h"

namespace mfir {
namespace {

constexpr size_t kMinNumOthers = 4;
constexpr double kFocalFloorPermille = 0.5;
constexpr double kPrincipalPointFloorPx = 0.25;
// The fewer other cameras, the less is known about their standard deviation.
constexpr double kMaxStds = 5.0;
constexpr double kMaxFocalStdsOfFew = 45.0;
constexpr double kMaxPrincipalPointStdsOfFew = 15.0;

constexpr double kMinAngleDeg = 0.05;
constexpr double kMinScatterRatio = 4.0;
constexpr double kMinOthersRatio = 5.0;
constexpr double kMadToStd = 1.4826;

// Standard deviation about zero of normal numbers, the largest tenth (at least
// one) left out.
double TrimmedStd(std::vector<double> values) {
  std::sort(values.begin(), values.end(), [](double a, double b) {
    return std::abs(a) < std::abs(b);
  });
  const size_t num_left_out = std::max<size_t>(1, values.size() / 10);
  const size_t count = values.size() - num_left_out;
  double sum = 0.0;
  for (size_t i = 0; i < count; ++i) sum += values[i] * values[i];
  // E[x^2 | |x| < q] = 1 - 2 q phi(q) / share, with q the quantile of the share
  // that is kept (bisection: erf has no inverse in std).
  const double share = (static_cast<double>(count) + 0.5) /
                       (static_cast<double>(values.size()) + 1.0);
  double low = 0.0;
  double high = 10.0;
  for (int i = 0; i < 60; ++i) {
    const double middle = 0.5 * (low + high);
    (std::erf(middle * M_SQRT1_2) < share ? low : high) = middle;
  }
  const double density = std::exp(-0.5 * low * low) / std::sqrt(2.0 * M_PI);
  const double variance = 1.0 - 2.0 * low * density / share;
  return std::sqrt(sum / static_cast<double>(count) / variance);
}

double MedianSize(std::vector<double> values) {
  for (double& value : values) value = std::abs(value);
  return Median(std::move(values));
}

// Of cameras other than `idx` that have one.
std::vector<double> Others(
    const std::vector<std::optional<CameraDrift>>& drifts,
    size_t idx,
    double (*value)(const CameraDrift&)) {
  std::vector<double> values;
  for (size_t i = 0; i < drifts.size(); ++i) {
    if (i != idx && drifts[i]) values.push_back(value(*drifts[i]));
  }
  return values;
}

// w in the header, by camera.
std::vector<double> ErrorsOfFew(const std::vector<size_t>& num_observations) {
  std::vector<double> numbers;
  for (const size_t number : num_observations) {
    if (number > 0) numbers.push_back(static_cast<double>(number));
  }
  const double median = numbers.empty() ? 1.0 : Median(std::move(numbers));
  std::vector<double> errors;
  for (const size_t number : num_observations) {
    const double count = static_cast<double>(std::max<size_t>(1, number));
    errors.push_back(std::sqrt(std::max(1.0, median / count)));
  }
  return errors;
}

// (value - center) / error.
std::vector<double> Normalized(std::vector<double> values,
                               double center,
                               const std::vector<double>& errors) {
  for (size_t i = 0; i < values.size(); ++i) {
    values[i] = (values[i] - center) / errors[i];
  }
  return values;
}

double Focal(const CameraDrift& drift) { return drift.focal_permille; }
double PrincipalPointX(const CameraDrift& drift) {
  return drift.principal_point.x();
}
double PrincipalPointY(const CameraDrift& drift) {
  return drift.principal_point.y();
}

CameraDrift MeasureDrift(const RigCamera& camera,
                         const std::vector<double>& before) {
  CameraDrift drift;
  const std::vector<size_t>& focal_idxs = camera.model->FocalLengthIdxs();
  for (const size_t idx : focal_idxs) {
    drift.focal_permille += 1000.0 * (camera.params[idx] / before[idx] - 1.0) /
                            static_cast<double>(focal_idxs.size());
  }
  const std::vector<size_t>& idxs = camera.model->PrincipalPointIdxs();
  for (int axis = 0; axis < 2; ++axis) {
    drift.principal_point(axis) =
        camera.params[idxs[axis]] - before[idxs[axis]];
  }
  return drift;
}

void CompareWithOthers(const std::vector<std::optional<CameraDrift>>& drifts,
                       const std::vector<double>& errors,
                       size_t idx,
                       CameraDrift* drift) {
  std::vector<double> others_errors;
  for (size_t i = 0; i < drifts.size(); ++i) {
    if (i != idx && drifts[i]) others_errors.push_back(errors[i]);
  }
  const std::vector<double> focal = Others(drifts, idx, Focal);
  if (focal.size() < kMinNumOthers) return;
  const double num_others = static_cast<double>(focal.size());
  drift->others_focal_permille = MedianSize(focal);
  const double focal_median = Median(focal);
  const double focal_std =
      TrimmedStd(Normalized(focal, focal_median, others_errors));
  drift->focal_stds = std::abs(drift->focal_permille - focal_median) /
                      std::hypot(errors[idx] * focal_std, kFocalFloorPermille);

  const std::vector<double> x = Others(drifts, idx, PrincipalPointX);
  const std::vector<double> y = Others(drifts, idx, PrincipalPointY);
  const Eigen::Vector2d median(Median(x), Median(y));
  std::vector<double> both = x;
  both.insert(both.end(), y.begin(), y.end());
  drift->others_principal_point = MedianSize(both);
  both = Normalized(x, median.x(), others_errors);
  const std::vector<double> both_y = Normalized(y, median.y(), others_errors);
  both.insert(both.end(), both_y.begin(), both_y.end());
  drift->principal_point_stds =
      (drift->principal_point - median).cwiseAbs().maxCoeff() /
      std::hypot(errors[idx] * TrimmedStd(both), kPrincipalPointFloorPx);
  drift->is_unusual =
      drift->focal_stds > kMaxStds + kMaxFocalStdsOfFew / num_others ||
      drift->principal_point_stds >
          kMaxStds + kMaxPrincipalPointStdsOfFew / num_others;
}

// Rotation vectors (degrees) from the known to the frames' rotations, those of
// all ranks.
std::vector<std::vector<Eigen::Vector3d>> RotationVectors(
    const Scene& scene, const Estimate& estimate) {
  struct Rotation {
    size_t camera_idx;
    double vector[3];
  };
  std::vector<Rotation> rotations;
  for (size_t f = 0; f < scene.frames.size(); ++f) {
    const std::vector<FrameImage>& images = scene.frames[f].images;
    for (size_t i = 0; i < images.size(); ++i) {
      const size_t camera_idx = images[i].camera_idx;
      const Eigen::AngleAxisd difference(
          estimate.frames[f].images[i].cam_from_world.rotation *
          scene.cameras[camera_idx].cam_from_world.rotation.conjugate());
      const Eigen::Vector3d vector =
          difference.angle() * 180.0 / M_PI * difference.axis();
      rotations.push_back({camera_idx, {vector.x(), vector.y(), vector.z()}});
    }
  }
  std::vector<std::vector<Eigen::Vector3d>> by_camera(scene.cameras.size());
  for (const Rotation& rotation : Concatenate(*scene.ranks, rotations)) {
    by_camera[rotation.camera_idx].emplace_back(rotation.vector);
  }
  return by_camera;
}

Eigen::Vector3d MedianVector(const std::vector<Eigen::Vector3d>& vectors) {
  Eigen::Vector3d median;
  for (int axis = 0; axis < 3; ++axis) {
    std::vector<double> values;
    for (const Eigen::Vector3d& vector : vectors) {
      values.push_back(vector(axis));
    }
    median(axis) = Median(values);
  }
  return median;
}

}  // namespace

std::vector<std::optional<CameraDrift>> FindDrifts(
    const std::vector<RigCamera>& cameras,
    const std::vector<size_t>& num_observations,
    const DriftReference& reference) {
  const std::vector<double> errors = ErrorsOfFew(num_observations);
  std::vector<std::optional<CameraDrift>> drifts(cameras.size());
  for (size_t i = 0; i < cameras.size(); ++i) {
    const bool has_reference =
        cameras[i].model != nullptr &&
        reference[i].size() == cameras[i].model->NumParams();
    if (has_reference) drifts[i] = MeasureDrift(cameras[i], reference[i]);
  }
  std::vector<std::optional<CameraDrift>> compared = drifts;
  for (size_t i = 0; i < cameras.size(); ++i) {
    if (compared[i]) CompareWithOthers(drifts, errors, i, &*compared[i]);
  }
  return compared;
}

std::vector<PoseDisagreement> FindPoseDisagreements(const Scene& scene,
                                                    const Estimate& estimate) {
  const std::vector<std::vector<Eigen::Vector3d>> rotations =
      RotationVectors(scene, estimate);
  const std::vector<size_t> num_observations = NumObservationsByCamera(scene);
  const std::vector<double> errors = ErrorsOfFew(num_observations);
  std::vector<PoseDisagreement> disagreements(scene.cameras.size());
  for (size_t i = 0; i < rotations.size(); ++i) {
    if (rotations[i].empty()) continue;
    const Eigen::Vector3d median = MedianVector(rotations[i]);
    std::vector<double> deviations;
    for (const Eigen::Vector3d& rotation : rotations[i]) {
      for (int axis = 0; axis < 3; ++axis) {
        deviations.push_back(std::abs(rotation(axis) - median(axis)));
      }
    }
    disagreements[i].angle_deg = median.norm();
    disagreements[i].scatter_deg = kMadToStd * Median(deviations);
  }
  for (size_t i = 0; i < rotations.size(); ++i) {
    PoseDisagreement& camera = disagreements[i];
    std::vector<double> others;
    for (size_t j = 0; j < rotations.size(); ++j) {
      if (j == i || rotations[j].empty()) continue;
      others.push_back(disagreements[j].angle_deg);
    }
    if (rotations[i].empty() || others.size() < kMinNumOthers) continue;
    camera.others_deg = Median(others);
    const double min_angle =
        std::max({kMinAngleDeg,
                  kMinScatterRatio * camera.scatter_deg,
                  kMinOthersRatio * errors[i] * camera.others_deg});
    const auto num_disagreeing =
        std::count_if(rotations[i].begin(),
                      rotations[i].end(),
                      [&](const Eigen::Vector3d& rotation) {
                        return rotation.norm() > min_angle;
                      });
    camera.is_moved =
        num_observations[i] >= kMinJudgedObservations &&
        camera.angle_deg > min_angle &&
        2 * static_cast<size_t>(num_disagreeing) > rotations[i].size();
  }
  return disagreements;
}

}  // namespace mfir
