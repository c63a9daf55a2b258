#include "colmap_ext/controllers/frame_verification.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

#include "src/feature/guided_matching.h"
#include "src/geometry/epipolar_tolerance.h"
#include "src/util/parallel_for.h"

namespace mfir {
namespace {

// Keypoints are no better than this; pixels.
constexpr double kMinTolerance = 1.0;
// Pairs with at least so many right matches tell their own tolerance.
constexpr size_t kMinInliersOfOwnTolerance = 30;
// Of wrong pairs in a frame that pass the test: at most 10^-3 expected.
constexpr double kMaxFalsePairs = 1e-3;
// Random pairs of keypoints per match, to learn how wrong matches look.
constexpr size_t kNumShifts = 20;

struct ImagePair {
  const DatabaseImage* image1 = nullptr;
  const DatabaseImage* image2 = nullptr;
  Eigen::Matrix3d essential_matrix;
  host::FeatureMatches matches;
  std::vector<double> errors;  // pixels, by match
  double random_share = 0.0;   // see EstimateEpipolarTolerance
  double max_error = 0.0;      // pixels
  EpipolarTolerance estimate;
  double tolerance = 0.0;
  host::FeatureMatches inlier_matches;
};

void ReadRays(const std::vector<RigCamera>& cameras,
              const host::Database& database,
              std::vector<DatabaseImage>* images) {
  for (DatabaseImage& image : *images) {
    const RigCamera& camera = cameras[image.camera_idx];
    for (const auto& keypoint : database.ReadKeypoints(image.image_id)) {
      Eigen::Vector2d uv;
      camera.model->Unproject(
          camera.params.data(), keypoint.x, keypoint.y, uv.data());
      image.rays.push_back(uv.homogeneous().normalized());
    }
  }
}

double MatchError(const ImagePair& pair,
                  const std::vector<RigCamera>& cameras,
                  size_t idx1,
                  size_t idx2) {
  // Also false for a keypoint outside of what the lens model can invert.
  const double error =
      EpipolarError(pair.essential_matrix,
                    pair.image1->rays[idx1],
                    pair.image2->rays[idx2],
                    MeanFocalLength(cameras[pair.image1->camera_idx]),
                    MeanFocalLength(cameras[pair.image2->camera_idx]));
  return std::isfinite(error) ? error : std::numeric_limits<double>::max();
}

// Errors of the matches, and of random pairs of the same keypoints.
void ComputeErrors(const std::vector<RigCamera>& cameras, ImagePair* pair) {
  const size_t n = pair->matches.size();
  for (const host::FeatureMatch& match : pair->matches) {
    pair->errors.push_back(
        MatchError(*pair, cameras, match.point2D_idx1, match.point2D_idx2));
  }
  // Laplace's rule keeps the share above 0.
  size_t num_random = 2;
  size_t num_within = 1;
  for (size_t shift = 1; shift < std::min(n, kNumShifts + 1); ++shift) {
    for (size_t i = 0; i < n; ++i) {
      const double error =
          MatchError(*pair,
                     cameras,
                     pair->matches[i].point2D_idx1,
                     pair->matches[(i + shift) % n].point2D_idx2);
      num_within += error <= pair->max_error;
      ++num_random;
    }
  }
  pair->random_share = static_cast<double>(num_within) / num_random;
  pair->estimate = EstimateEpipolarTolerance(
      pair->errors, pair->random_share, kMinTolerance, pair->max_error);
}

std::vector<ImagePair> ReadPairs(const TriangulatorOptions& options,
                                 const std::vector<RigCamera>& cameras,
                                 const std::vector<DatabaseImage>& images,
                                 const host::Database& database) {
  std::map<host::image_t, const DatabaseImage*> images_by_id;
  for (const DatabaseImage& image : images)
    images_by_id[image.image_id] = &image;
  std::vector<ImagePair> pairs;
  for (auto& [pair_id, matches] : database.ReadAllMatches()) {
    const auto [id1, id2] = host::PairIdToImagePair(pair_id);
    if (images_by_id.count(id1) == 0 || images_by_id.count(id2) == 0) continue;
    ImagePair pair;
    pair.image1 = images_by_id[id1];
    pair.image2 = images_by_id[id2];
    for (const host::FeatureMatch& match : matches) {
      if (match.point2D_idx1 < pair.image1->rays.size() &&
          match.point2D_idx2 < pair.image2->rays.size()) {
        pair.matches.push_back(match);
      }
    }
    const RigCamera& camera1 = cameras[pair.image1->camera_idx];
    const RigCamera& camera2 = cameras[pair.image2->camera_idx];
    pair.essential_matrix =
        EssentialMatrix(camera1.cam_from_world, camera2.cam_from_world);
    pair.max_error =
        options.max_epipolar_error *
        std::max(
            {camera1.width, camera1.height, camera2.width, camera2.height});
    if (pair.matches.size() >= static_cast<size_t>(options.min_num_inliers) &&
        pair.essential_matrix.allFinite()) {
      ComputeErrors(cameras, &pair);
      pairs.push_back(std::move(pair));
    }
  }
  return pairs;
}

// Pairs with few matches take the tolerance of the others.
void SetTolerances(std::vector<ImagePair>* pairs) {
  std::vector<double> tolerances;
  for (const ImagePair& pair : *pairs) {
    if (pair.estimate.num_inliers >= kMinInliersOfOwnTolerance) {
      tolerances.push_back(pair.estimate.tolerance);
    }
  }
  for (ImagePair& pair : *pairs) {
    const bool is_own = tolerances.empty() ||
                        pair.estimate.num_inliers >= kMinInliersOfOwnTolerance;
    pair.tolerance = is_own
                         ? pair.estimate.tolerance
                         : std::min(Quantile(tolerances, 0.5), pair.max_error);
  }
}

// Keeps the matches within the tolerance; drops pairs whose number of these
// could be chance.
void SelectInliers(const TriangulatorOptions& options,
                   std::vector<ImagePair>* pairs) {
  const double max_log_nfa = std::log(kMaxFalsePairs / pairs->size());
  for (ImagePair& pair : *pairs) {
    for (size_t i = 0; i < pair.matches.size(); ++i) {
      if (pair.errors[i] <= pair.tolerance) {
        pair.inlier_matches.push_back(pair.matches[i]);
      }
    }
    const size_t num_inliers = pair.inlier_matches.size();
    if (num_inliers < static_cast<size_t>(options.min_num_inliers) ||
        LogNumFalseAlarms(pair.matches.size(),
                          num_inliers,
                          pair.tolerance,
                          pair.random_share,
                          pair.max_error) > max_log_nfa) {
      pair.inlier_matches.clear();
    }
  }
  pairs->erase(std::remove_if(pairs->begin(),
                              pairs->end(),
                              [](const ImagePair& pair) {
                                return pair.inlier_matches.empty();
                              }),
               pairs->end());
}

// Of other extractors' databases some have no descriptors, or such that
// COLMAP's matching cannot take.
bool HasSiftDescriptors(const DatabaseImage& image,
                        const host::FeatureDescriptors& descriptors) {
  return descriptors.data.cols() == 128 &&
         static_cast<size_t>(descriptors.data.rows()) == image.rays.size();
}

// Matches again with only the keypoints near the epipolar line as candidates.
void MatchPairsGuided(const TriangulatorOptions& options,
                      const std::vector<RigCamera>& cameras,
                      const host::Database& database,
                      int num_threads,
                      std::vector<ImagePair>* pairs) {
  std::map<const DatabaseImage*, host::FeatureDescriptors> descriptors;
  for (const ImagePair& pair : *pairs) {
    for (const DatabaseImage* image : {pair.image1, pair.image2}) {
      if (descriptors.count(image) > 0) continue;
      descriptors[image] = host::ReadDescriptors(database, image->image_id);
    }
  }
  const auto features = [&](const DatabaseImage& image) {
    const RigCamera& camera = cameras[image.camera_idx];
    return ImageFeatures{camera.cam_from_world,
                         MeanFocalLength(camera),
                         &image.rays,
                         descriptors.at(&image).data.data()};
  };
  const auto& sift = host::SiftMatching(options.feature_matching);
  ParallelFor(pairs->size(), num_threads, [&](size_t i) {
    ImagePair& pair = (*pairs)[i];
    if (!HasSiftDescriptors(*pair.image1, descriptors.at(pair.image1)) ||
        !HasSiftDescriptors(*pair.image2, descriptors.at(pair.image2))) {
      return;
    }
    const auto matches = MatchGuided(
        {pair.tolerance, sift.max_distance, sift.max_ratio, sift.cross_check},
        features(*pair.image1),
        features(*pair.image2));
    if (matches.size() <= pair.inlier_matches.size()) return;
    pair.inlier_matches.clear();
    for (const auto& [idx1, idx2] : matches) {
      pair.inlier_matches.emplace_back(idx1, idx2);
    }
  });
}

void WriteTwoViewGeometries(const std::vector<RigCamera>& cameras,
                            const std::vector<ImagePair>& pairs,
                            host::Database* database) {
  for (const ImagePair& pair : pairs) {
    const Rigid3& pose1 = cameras[pair.image1->camera_idx].cam_from_world;
    const Rigid3& pose2 = cameras[pair.image2->camera_idx].cam_from_world;
    Rigid3 pose2_from_pose1;
    pose2_from_pose1.rotation = pose2.rotation * pose1.rotation.conjugate();
    pose2_from_pose1.translation =
        pose2.translation - pose2_from_pose1.rotation * pose1.translation;
    host::WriteCalibratedGeometry(pair.image1->image_id,
                                  pair.image2->image_id,
                                  pair.essential_matrix,
                                  pose2_from_pose1,
                                  pair.inlier_matches,
                                  database);
  }
}

}  // namespace

double MeanFocalLength(const RigCamera& camera) {
  double sum = 0.0;
  for (const size_t idx : camera.model->FocalLengthIdxs()) {
    sum += camera.params[idx];
  }
  return sum / camera.model->FocalLengthIdxs().size();
}

double Quantile(std::vector<double> values, double share) {
  if (values.empty()) return 0.0;
  const size_t idx = static_cast<size_t>(share * (values.size() - 1));
  std::nth_element(values.begin(), values.begin() + idx, values.end());
  return values[idx];
}

void VerifyMatches(const TriangulatorOptions& options,
                   const std::vector<RigCamera>& cameras,
                   std::vector<DatabaseImage> images,
                   int num_threads,
                   host::Database* database,
                   FrameStatistics* statistics) {
  ReadRays(cameras, *database, &images);
  std::vector<ImagePair> pairs = ReadPairs(options, cameras, images, *database);
  for (const ImagePair& pair : pairs) {
    statistics->num_matches += pair.matches.size();
  }
  SetTolerances(&pairs);
  SelectInliers(options, &pairs);
  if (options.feature_matching.guided_matching) {
    MatchPairsGuided(options, cameras, *database, num_threads, &pairs);
  }
  WriteTwoViewGeometries(cameras, pairs, database);
  std::vector<double> tolerances;
  for (const ImagePair& pair : pairs) tolerances.push_back(pair.tolerance);
  statistics->median_tolerance = Quantile(tolerances, 0.5);
  statistics->large_tolerance = Quantile(tolerances, 0.9);
}

}  // namespace mfir
