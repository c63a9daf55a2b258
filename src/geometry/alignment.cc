#include "src/geometry/alignment.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "src/util/median.h"

namespace mfir {
namespace {

// A pose agrees with the alignment when the angle between the rotations (rad)
// and the distance of the centres (relative to the spread of the target) both
// stay below the first of these. Wrong intrinsics move poses of a
// reconstruction by a few percent; a wrong pose is off by much more. Where too
// few poses agree, the reconstruction as a whole may be bent (long lenses):
// then the second limit applies.
constexpr double kMaxInlierErrors[] = {0.15, 0.5};
constexpr double kMinInlierRatio = 0.5;
constexpr size_t kMinNumPoses = 3;
constexpr size_t kMaxNumHypotheses = 20000;
constexpr int kNumRefinements = 10;

struct PosePair {
  Eigen::Quaterniond target_from_source;  // what this camera alone tells
  Eigen::Vector3d source_center;
  Eigen::Vector3d target_center;
};

// The centres without those that are absurdly far from the others: one wrong
// coordinate must not set the scale of all.
std::vector<Eigen::Vector3d> WithoutFarCenters(
    const std::vector<Eigen::Vector3d>& centers) {
  constexpr double kMaxDistance = 10.0;  // median distances
  Eigen::Vector3d middle;
  for (int axis = 0; axis < 3; ++axis) {
    std::vector<double> coordinates;
    for (const Eigen::Vector3d& center : centers) {
      coordinates.push_back(center(axis));
    }
    middle(axis) = UpperMedian(coordinates);
  }
  std::vector<double> distances;
  for (const Eigen::Vector3d& center : centers) {
    distances.push_back((center - middle).norm());
  }
  const double max_distance = kMaxDistance * UpperMedian(distances);
  std::vector<Eigen::Vector3d> near;
  for (size_t i = 0; i < centers.size(); ++i) {
    // All, where more than half of the centres coincide.
    if (distances[i] <= max_distance || max_distance == 0.0) {
      near.push_back(centers[i]);
    }
  }
  return near;
}

// Mean and RMS distance from it, without centres that are far from the others.
std::pair<Eigen::Vector3d, double> MeanAndSpread(
    const std::vector<Eigen::Vector3d>& centers) {
  const std::vector<Eigen::Vector3d> near = WithoutFarCenters(centers);
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& center : near) mean += center / near.size();
  double sum = 0.0;
  for (const Eigen::Vector3d& center : near) {
    sum += (center - mean).squaredNorm();
  }
  return {mean, std::sqrt(sum / near.size())};
}

double PoseError(const Similarity3& alignment,
                 double spread,
                 const PosePair& pair) {
  const double center_error =
      (alignment * pair.source_center - pair.target_center).norm() / spread;
  return std::max(center_error,
                  alignment.rotation.angularDistance(pair.target_from_source));
}

// Chordal mean: the dominant eigenvector of the sum of q q^T.
Eigen::Quaterniond MeanRotation(const std::vector<const PosePair*>& pairs) {
  Eigen::Matrix4d sum = Eigen::Matrix4d::Zero();
  for (const PosePair* pair : pairs) {
    const Eigen::Vector4d q = pair->target_from_source.coeffs();
    sum += q * q.transpose();
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d> eigen(sum);
  Eigen::Quaterniond mean;
  mean.coeffs() = eigen.eigenvectors().col(3);
  return mean.normalized();
}

// Least squares over the given poses: rotation from the rotations, then scale
// and translation from the centres. False if the centres coincide.
bool FitSimilarity(const std::vector<const PosePair*>& pairs,
                   Similarity3* alignment) {
  alignment->rotation = MeanRotation(pairs);
  Eigen::Vector3d source_mean = Eigen::Vector3d::Zero();
  Eigen::Vector3d target_mean = Eigen::Vector3d::Zero();
  for (const PosePair* pair : pairs) {
    source_mean += pair->source_center / pairs.size();
    target_mean += pair->target_center / pairs.size();
  }
  double dot = 0.0;
  double source_sum = 0.0;
  for (const PosePair* pair : pairs) {
    const Eigen::Vector3d source =
        alignment->rotation * (pair->source_center - source_mean);
    dot += source.dot(pair->target_center - target_mean);
    source_sum += source.squaredNorm();
  }
  if (!(dot > 0.0) || !(source_sum > 0.0)) {
    return false;
  }
  alignment->scale = dot / source_sum;
  alignment->translation =
      target_mean - alignment->scale * (alignment->rotation * source_mean);
  return true;
}

// The pair hypothesis with the smallest truncated cost. False if no pair gives
// one.
bool FindBestHypothesis(const std::vector<PosePair>& pairs,
                        double spread,
                        double max_error,
                        Similarity3* best) {
  const size_t num_pairs = pairs.size() * (pairs.size() - 1) / 2;
  const size_t stride = 1 + num_pairs / kMaxNumHypotheses;
  double best_cost = std::numeric_limits<double>::max();
  size_t index = 0;
  for (size_t i = 0; i < pairs.size(); ++i) {
    for (size_t j = i + 1; j < pairs.size(); ++j, ++index) {
      Similarity3 hypothesis;
      if (index % stride != 0 ||
          pairs[i].target_from_source.angularDistance(
              pairs[j].target_from_source) > 2.0 * max_error ||
          !FitSimilarity({&pairs[i], &pairs[j]}, &hypothesis)) {
        continue;
      }
      double cost = 0.0;
      for (const PosePair& pair : pairs) {
        const double error =
            std::min(max_error, PoseError(hypothesis, spread, pair));
        cost += error * error;
      }
      if (cost < best_cost) {
        best_cost = cost;
        *best = hypothesis;
      }
    }
  }
  return best_cost < std::numeric_limits<double>::max();
}

std::vector<const PosePair*> SelectInliers(const Similarity3& alignment,
                                           double spread,
                                           double max_error,
                                           const std::vector<PosePair>& pairs,
                                           std::vector<bool>* inliers) {
  std::vector<const PosePair*> selected;
  inliers->assign(pairs.size(), false);
  for (size_t i = 0; i < pairs.size(); ++i) {
    if (PoseError(alignment, spread, pairs[i]) < max_error) {
      selected.push_back(&pairs[i]);
      (*inliers)[i] = true;
    }
  }
  return selected;
}

// Fits to the inliers until they stay the same; returns them.
std::vector<const PosePair*> RefineAlignment(const std::vector<PosePair>& pairs,
                                             double spread,
                                             double max_error,
                                             Similarity3* alignment,
                                             std::vector<bool>* inliers) {
  std::vector<const PosePair*> selected =
      SelectInliers(*alignment, spread, max_error, pairs, inliers);
  for (int i = 0; i < kNumRefinements && selected.size() >= 2; ++i) {
    const std::vector<bool> previous = *inliers;
    if (!FitSimilarity(selected, alignment)) break;
    selected = SelectInliers(*alignment, spread, max_error, pairs, inliers);
    if (*inliers == previous) break;
  }
  return selected;
}

}  // namespace

PoseAlignment AlignPoses(const std::vector<Rigid3>& source_cams_from_world,
                         const std::vector<Rigid3>& target_cams_from_world) {
  PoseAlignment result;
  std::vector<PosePair> pairs;
  std::vector<Eigen::Vector3d> target_centers;
  for (size_t i = 0; i < source_cams_from_world.size(); ++i) {
    const Rigid3& source = source_cams_from_world[i];
    const Rigid3& target = target_cams_from_world[i];
    pairs.push_back(
        {(target.rotation.conjugate() * source.rotation).normalized(),
         source.Center(),
         target.Center()});
    target_centers.push_back(target.Center());
  }
  if (pairs.size() < kMinNumPoses) {
    result.failure = "only " + std::to_string(pairs.size()) +
                     " of its images belong to cameras of the rig, " +
                     std::to_string(kMinNumPoses) + " are needed";
    return result;
  }

  const double spread = MeanAndSpread(target_centers).second;
  for (const double max_error : kMaxInlierErrors) {
    Similarity3& alignment = result.target_from_source;
    if (!(spread > 0.0) ||
        !FindBestHypothesis(pairs, spread, max_error, &alignment)) {
      continue;
    }
    const std::vector<const PosePair*> inliers =
        RefineAlignment(pairs, spread, max_error, &alignment, &result.inliers);
    result.num_inliers = inliers.size();
    if (inliers.size() < kMinNumPoses ||
        inliers.size() < kMinInlierRatio * static_cast<double>(pairs.size())) {
      continue;
    }
    double sum = 0.0;
    for (const PosePair* pair : inliers) {
      sum +=
          (alignment * pair->source_center - pair->target_center).squaredNorm();
    }
    result.rms_center_error =
        std::sqrt(sum / static_cast<double>(inliers.size()));
    std::vector<double> errors;
    for (const PosePair& pair : pairs) {
      errors.push_back(PoseError(alignment, spread, pair));
    }
    result.median_error = UpperMedian(errors);
    return result;
  }
  result.failure = "only " + std::to_string(result.num_inliers) + " of " +
                   std::to_string(pairs.size()) +
                   " camera poses fit the known extrinsics";
  return result;
}

Similarity3 NormalizeRig(const std::vector<Rigid3>& cams_from_world) {
  std::vector<Eigen::Vector3d> centers;
  for (const Rigid3& cam_from_world : cams_from_world) {
    centers.push_back(cam_from_world.Center());
  }
  const auto [mean, rms] = MeanAndSpread(centers);
  Similarity3 normalized_from_world;
  normalized_from_world.scale = rms > 0.0 ? 1000.0 / rms : 1.0;
  normalized_from_world.translation = -normalized_from_world.scale * mean;
  return normalized_from_world;
}

Similarity3 Inverse(const Similarity3& b_from_a) {
  Similarity3 a_from_b;
  a_from_b.scale = 1.0 / b_from_a.scale;
  a_from_b.rotation = b_from_a.rotation.conjugate();
  a_from_b.translation =
      -a_from_b.scale * (a_from_b.rotation * b_from_a.translation);
  return a_from_b;
}

Similarity3 operator*(const Similarity3& c_from_b,
                      const Similarity3& b_from_a) {
  Similarity3 c_from_a;
  c_from_a.scale = c_from_b.scale * b_from_a.scale;
  c_from_a.rotation = (c_from_b.rotation * b_from_a.rotation).normalized();
  c_from_a.translation = c_from_b * b_from_a.translation;
  return c_from_a;
}

Rigid3 TransformPose(const Similarity3& new_from_old,
                     const Rigid3& cam_from_old) {
  // Camera coordinates are scaled with the world.
  Rigid3 cam_from_new;
  cam_from_new.rotation =
      (cam_from_old.rotation * new_from_old.rotation.conjugate()).normalized();
  cam_from_new.translation = new_from_old.scale * cam_from_old.translation -
                             cam_from_new.rotation * new_from_old.translation;
  return cam_from_new;
}

}  // namespace mfir
