#include "colmap_ext/controllers/frame_verification.h"

#include <algorithm>
#include <atomic>
#include <map>

#include "colmap_ext/controllers/pair_tolerance.h"
#include "src/feature/descriptor_products.h"
#include "src/feature/epipolar_drift.h"
#include "src/feature/guided_matching.h"
#include "src/geometry/epipolar_tolerance.h"
#include "src/parallel/parallel_for.h"

namespace mfir {
namespace {

// Keypoints of image 1 in the sample; all where these give too few matches.
constexpr size_t kSampleSize = 1000;
// Of each pair.
constexpr size_t kMatchesForDrift = 200;

// Calls function(i) for i in [0, count) on threads; then counts on.
template <typename Function>
void ForEach(size_t count,
             int num_threads,
             const ProgressFunction& progress,
             const Function& function) {
  std::atomic<size_t> num_done = 0;
  ParallelForWithWorkers(
      count,
      std::max(1, num_threads),
      []() { return 0; },
      [&](int, size_t i) {
        function(i);
        const size_t num = ++num_done;
        if (progress) progress(num, count);
      });
}

std::vector<MatchingImage> ReadImages(const TriangulatorOptions& options,
                                      const std::vector<RigCamera>& cameras,
                                      const std::vector<DatabaseImage>& images,
                                      const host::Database& database) {
  std::vector<MatchingImage> result;
  for (const DatabaseImage& source : images) {
    const RigCamera& camera = cameras[source.camera_idx];
    MatchingImage image;
    image.image_id = source.image_id;
    image.camera_idx = source.camera_idx;
    image.focal_length = MeanFocalLength(camera);
    image.keypoints = database.ReadKeypoints(source.image_id);
    if (options.feature_matching.guided_matching) {
      image.descriptors = host::ReadDescriptors(database, source.image_id);
    }
    result.push_back(std::move(image));
  }
  return result;
}

// Of other extractors' databases some have no descriptors, or none that can be
// compared as SIFT's are.
bool HasSiftDescriptors(const MatchingImage& image) {
  return image.descriptors.data.cols() == kSiftDescriptorSize &&
         static_cast<size_t>(image.descriptors.data.rows()) ==
             image.keypoints.size();
}

// Without matches; nothing where the epipolar geometry is not defined.
void AddPair(const TriangulatorOptions& options,
             const std::vector<RigCamera>& cameras,
             const MatchingImage& image1,
             const MatchingImage& image2,
             std::vector<MatchingPair>* pairs) {
  const RigCamera& camera1 = cameras[image1.camera_idx];
  const RigCamera& camera2 = cameras[image2.camera_idx];
  MatchingPair pair;
  pair.image1 = &image1;
  pair.image2 = &image2;
  pair.essential_matrix =
      EssentialMatrix(camera1.cam_from_world, camera2.cam_from_world);
  if (!pair.essential_matrix.allFinite()) return;
  pair.max_error =
      options.max_epipolar_error *
      std::max({camera1.width, camera1.height, camera2.width, camera2.height});
  pair.is_guided = options.feature_matching.guided_matching &&
                   HasSiftDescriptors(image1) && HasSiftDescriptors(image2);
  pairs->push_back(std::move(pair));
}

std::vector<MatchingPair> PairsOfCameras(
    const TriangulatorOptions& options,
    const std::vector<RigCamera>& cameras,
    const std::vector<MatchingImage>& images,
    const std::vector<std::pair<size_t, size_t>>& camera_pairs) {
  std::map<size_t, const MatchingImage*> images_by_camera;
  for (const MatchingImage& image : images) {
    images_by_camera[image.camera_idx] = &image;
  }
  std::vector<MatchingPair> pairs;
  for (const auto& [idx1, idx2] : camera_pairs) {
    const auto image1 = images_by_camera.find(idx1);
    const auto image2 = images_by_camera.find(idx2);
    if (image1 == images_by_camera.end() || image2 == images_by_camera.end()) {
      continue;
    }
    AddPair(options, cameras, *image1->second, *image2->second, &pairs);
  }
  return pairs;
}

std::vector<MatchingPair> PairsOfDatabase(
    const TriangulatorOptions& options,
    const std::vector<RigCamera>& cameras,
    const std::vector<MatchingImage>& images,
    const host::Database& database) {
  std::map<host::image_t, const MatchingImage*> images_by_id;
  for (const MatchingImage& image : images) {
    images_by_id[image.image_id] = &image;
  }
  std::vector<MatchingPair> pairs;
  for (const auto& [pair_id, matches] : database.ReadAllMatches()) {
    const auto [id1, id2] = host::PairIdToImagePair(pair_id);
    if (images_by_id.count(id1) == 0 || images_by_id.count(id2) == 0) continue;
    const size_t num_before = pairs.size();
    AddPair(options, cameras, *images_by_id[id1], *images_by_id[id2], &pairs);
    if (pairs.size() == num_before) continue;
    MatchingPair& pair = pairs.back();
    for (const host::FeatureMatch& match : matches) {
      if (match.point2D_idx1 < pair.image1->rays.size() &&
          match.point2D_idx2 < pair.image2->rays.size()) {
        pair.stored_matches.push_back(match);
      }
    }
  }
  return pairs;
}

IndexMatches Match(const TriangulatorOptions& options,
                   const std::vector<RigCamera>& cameras,
                   double max_error,
                   size_t query_stride,
                   const MatchingPair& pair) {
  const auto& sift = host::SiftMatching(options.feature_matching);
  const auto features = [&](const MatchingImage& image) {
    return ImageFeatures{cameras[image.camera_idx].cam_from_world,
                         image.focal_length,
                         &image.rays,
                         image.descriptors.data.data()};
  };
  return MatchGuided({max_error,
                      sift.max_distance,
                      sift.max_ratio,
                      sift.cross_check,
                      query_stride},
                     features(*pair.image1),
                     features(*pair.image2));
}

// Sets the rays of the keypoints, corrected for the drift of the camera.
void SetRays(const std::vector<RigCamera>& cameras,
             const std::vector<PixelDrift>& drifts,
             int num_threads,
             std::vector<MatchingImage>* images) {
  ForEach(images->size(), num_threads, {}, [&](size_t i) {
    MatchingImage& image = (*images)[i];
    const RigCamera& camera = cameras[image.camera_idx];
    image.rays.clear();
    for (const host::FeatureKeypoint& keypoint : image.keypoints) {
      const Eigen::Vector2d xy = drifts[image.camera_idx].Correct(
          camera, Eigen::Vector2d(keypoint.x, keypoint.y));
      Eigen::Vector2d uv;
      camera.model->Unproject(camera.params.data(), xy.x(), xy.y(), uv.data());
      image.rays.push_back(uv.homogeneous().normalized());
    }
  });
}

// Sets the sample and the tolerance that it tells.
void Sample(const TriangulatorOptions& options,
            const std::vector<RigCamera>& cameras,
            MatchingPair* pair) {
  if (!pair->is_guided) {
    for (const host::FeatureMatch& match : pair->stored_matches) {
      pair->sample.emplace_back(match.point2D_idx1, match.point2D_idx2);
    }
    EstimateTolerance(pair);
    return;
  }
  const size_t stride =
      std::max<size_t>(1, pair->image1->rays.size() / kSampleSize);
  pair->sample = Match(options, cameras, pair->max_error, stride, *pair);
  EstimateTolerance(pair);
  if (stride > 1 && !HasOwnTolerance(*pair)) {
    pair->sample = Match(options, cameras, pair->max_error, 1, *pair);
    EstimateTolerance(pair);
  }
}

// What the right matches of the samples tell of the intrinsics.
std::vector<PixelDrift> EstimateDrift(const std::vector<RigCamera>& cameras,
                                      const std::vector<MatchingPair>& pairs) {
  std::vector<EpipolarMatch> matches;
  for (const MatchingPair& pair : pairs) {
    if (CouldBeChance(pair, pairs.size())) continue;
    const auto xy = [](const MatchingImage& image, uint32_t idx) {
      return Eigen::Vector2d(image.keypoints[idx].x, image.keypoints[idx].y);
    };
    const size_t stride =
        std::max<size_t>(1, pair.sample.size() / kMatchesForDrift);
    for (size_t i = 0; i < pair.sample.size(); i += stride) {
      if (pair.errors[i] > pair.tolerance) continue;
      const auto [idx1, idx2] = pair.sample[i];
      matches.push_back({pair.image1->camera_idx,
                         pair.image2->camera_idx,
                         xy(*pair.image1, idx1),
                         xy(*pair.image2, idx2)});
    }
  }
  return EstimateEpipolarDrift(cameras, matches);
}

double MedianTolerance(const std::vector<MatchingPair>& pairs) {
  std::vector<double> tolerances;
  for (const MatchingPair& pair : pairs) tolerances.push_back(pair.tolerance);
  return Quantile(tolerances, 0.5);
}

// Looks for matches where the drifted intrinsics would have them, and with a
// tolerance that no longer covers the drift. Changes nothing where that is not
// smaller.
void TightenTolerances(const std::vector<RigCamera>& cameras,
                       int num_threads,
                       std::vector<MatchingImage>* images,
                       std::vector<MatchingPair>* pairs) {
  const auto estimate = [&](const std::vector<PixelDrift>& drifts) {
    SetRays(cameras, drifts, num_threads, images);
    ForEach(pairs->size(), num_threads, {}, [&](size_t i) {
      EstimateTolerance(&(*pairs)[i]);
    });
    SetTolerances(pairs);
    return MedianTolerance(*pairs);
  };
  const double before = MedianTolerance(*pairs);
  if (estimate(EstimateDrift(cameras, *pairs)) >= before) {
    estimate(std::vector<PixelDrift>(cameras.size()));
  }
}

// Sets the matches within the tolerance.
void MatchWithinTolerance(const TriangulatorOptions& options,
                          const std::vector<RigCamera>& cameras,
                          MatchingPair* pair) {
  for (const host::FeatureMatch& match : pair->stored_matches) {
    if (MatchError(*pair, match.point2D_idx1, match.point2D_idx2) <=
        pair->tolerance) {
      pair->matches.push_back(match);
    }
  }
  if (!pair->is_guided) return;
  const IndexMatches matches =
      Match(options, cameras, pair->tolerance, /*query_stride=*/1, *pair);
  if (matches.size() <= pair->matches.size()) return;
  pair->matches.clear();
  for (const auto& [idx1, idx2] : matches) {
    pair->matches.emplace_back(idx1, idx2);
  }
}

void WriteTwoViewGeometry(const std::vector<RigCamera>& cameras,
                          const MatchingPair& pair,
                          host::Database* database) {
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
                                pair.matches,
                                database);
}

// Writes what was found. Of pairs whose number of matches could be chance, no
// geometry.
void WriteMatches(const TriangulatorOptions& options,
                  const std::vector<RigCamera>& cameras,
                  const std::vector<MatchingPair>& pairs,
                  const std::vector<double>& drift_tolerances,
                  bool are_new,
                  host::Database* database,
                  FrameStatistics* statistics) {
  std::vector<double> tolerances;
  for (size_t i = 0; i < pairs.size(); ++i) {
    const MatchingPair& pair = pairs[i];
    statistics->num_matches +=
        are_new ? pair.matches.size() : pair.stored_matches.size();
    if (are_new) {
      database->WriteMatches(
          pair.image1->image_id, pair.image2->image_id, pair.matches);
    }
    if (pair.matches.size() < static_cast<size_t>(options.min_num_inliers) ||
        CouldBeChance(pair, pairs.size())) {
      continue;
    }
    WriteTwoViewGeometry(cameras, pair, database);
    tolerances.push_back(drift_tolerances[i]);
  }
  statistics->median_tolerance = Quantile(tolerances, 0.5);
  statistics->large_tolerance = Quantile(tolerances, 0.9);
}

// One of two passes over all pairs, 0 or 1.
ProgressFunction CountPass(size_t pass, const ProgressFunction& progress) {
  if (!progress) return {};
  return [&progress, pass](size_t num_done, size_t num_all) {
    progress((pass * num_all + num_done) / 2, num_all);
  };
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
                   const std::vector<DatabaseImage>& images,
                   const std::vector<std::pair<size_t, size_t>>& camera_pairs,
                   int num_threads,
                   const ProgressFunction& progress,
                   host::Database* database,
                   FrameStatistics* statistics) {
  std::vector<MatchingImage> matching_images =
      ReadImages(options, cameras, images, *database);
  SetRays(cameras,
          std::vector<PixelDrift>(cameras.size()),
          num_threads,
          &matching_images);
  const bool are_new = database->NumMatches() == 0;
  std::vector<MatchingPair> pairs =
      are_new ? PairsOfCameras(options, cameras, matching_images, camera_pairs)
              : PairsOfDatabase(options, cameras, matching_images, *database);

  ForEach(pairs.size(), num_threads, CountPass(0, progress), [&](size_t i) {
    Sample(options, cameras, &pairs[i]);
  });
  SetTolerances(&pairs);
  std::vector<double> drift_tolerances;
  for (const MatchingPair& pair : pairs) {
    drift_tolerances.push_back(pair.tolerance);
  }
  TightenTolerances(cameras, num_threads, &matching_images, &pairs);
  ForEach(pairs.size(), num_threads, CountPass(1, progress), [&](size_t i) {
    MatchWithinTolerance(options, cameras, &pairs[i]);
  });
  WriteMatches(
      options, cameras, pairs, drift_tolerances, are_new, database, statistics);
}

}  // namespace mfir
