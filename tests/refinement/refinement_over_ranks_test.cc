// Frames on several ranks give what one process gives.

#include <algorithm>
#include <cmath>
#include <mutex>

#include <gtest/gtest.h>

#include "src/evaluation/drift_check.h"
#include "src/evaluation/extrinsics_check.h"
#include "src/refinement/initial_intrinsics.h"
#include "src/refinement/refinement.h"
#include "src/scene/residual_statistics.h"
#include "src/selection/held_out_tracks.h"
#include "src/selection/static_point_search.h"
#include "src/selection/static_points.h"
#include "tests/support/test_scenes.h"
#include "tests/support/thread_ranks.h"

namespace mfir {
namespace {

// Relative.
constexpr double kTolerance = 1e-9;
// Of what is sensitive to points, which stop within their own tolerance.
constexpr double kPointTolerance = 1e-5;

MultiFrameOptions Options() {
  MultiFrameOptions options;
  options.ApplyPreset("accurate");
  options.num_threads = 1;
  return options;
}

// Four frames, the last of which repeats half of the tracks of the first.
SceneEstimate MakeScene() {
  TestSceneOptions options;
  options.num_frames = 4;
  options.num_points = 150;
  options.track_length = 5;
  options.outlier_share = 0.05;
  SceneEstimate start = MakeTestScene(options).start;
  const Frame& first = start.scene.frames.front();
  Frame& last = start.scene.frames.back();
  const size_t num_points = first.NumPoints() / 2;
  last.images = first.images;
  last.track_begins.assign(first.track_begins.begin(),
                           first.track_begins.begin() + num_points + 1);
  last.observations.assign(
      first.observations.begin(),
      first.observations.begin() + last.track_begins.back());
  FrameEstimate& estimate = start.estimate.frames.back();
  estimate = start.estimate.frames.front();
  estimate.points.resize(num_points);
  return start;
}

// The frames of the rank.
SceneEstimate Share(const SceneEstimate& all, const Communicator& ranks) {
  SceneEstimate share = all;
  share.scene.ranks = &ranks;
  const size_t num = all.scene.frames.size();
  const size_t begin = num * ranks.Rank() / ranks.NumRanks();
  const size_t end = num * (ranks.Rank() + 1) / ranks.NumRanks();
  const auto keep = [&](auto* frames) {
    frames->erase(frames->begin() + end, frames->end());
    frames->erase(frames->begin(), frames->begin() + begin);
  };
  keep(&share.scene.frames);
  keep(&share.estimate.frames);
  return share;
}

// What a run finds out.
struct Found {
  RefinementResult refinement;
  std::vector<double> stds_px;
  std::vector<double> rms_px;
  std::vector<PoseDisagreement> poses;
  StaticPointStatistics static_points;
};

Found RefineCapture(const MultiFrameOptions& options, SceneEstimate start) {
  Found found;
  start = InitializeIntrinsics(options, std::move(start));
  const Scene& scene = start.scene;
  const Selection selection = HoldOutTracks(
      options.held_out_share,
      scene,
      SelectStaticPoints(options.static_points, scene, &found.static_points));
  SceneEstimate fitted =
      SelectTracks(selection, TrackRole::kFitted, scene, start.estimate);
  found.refinement = RefineFixedExtrinsics(
      options,
      true,
      [](const Stage&) {},
      fitted.scene,
      std::move(fitted.estimate));
  const std::vector<double> squared =
      SquaredResiduals(fitted.scene, found.refinement.estimate, false);
  found.stds_px = RobustStdByCamera(fitted.scene, squared);
  const double max_squared =
      MaxInlierSquaredResidual(squared, *fitted.scene.ranks);
  std::vector<bool> inliers;
  for (const double value : squared) inliers.push_back(value <= max_squared);
  found.rms_px = RmsByCamera(fitted.scene, squared, inliers);
  found.poses = FindPoseDisagreements(scene, start.estimate);
  return found;
}

void ExpectNear(const std::vector<double>& values,
                const std::vector<double>& expected,
                double tolerance = kTolerance) {
  ASSERT_EQ(values.size(), expected.size());
  for (size_t i = 0; i < values.size(); ++i) {
    EXPECT_NEAR(values[i], expected[i], tolerance * std::abs(expected[i]));
  }
}

void ExpectNear(const Found& found, const Found& expected) {
  EXPECT_TRUE(found.refinement.converged);
  const auto& cameras = expected.refinement.estimate.cameras;
  for (size_t i = 0; i < cameras.size(); ++i) {
    ExpectNear(found.refinement.estimate.cameras[i].params, cameras[i].params);
    EXPECT_NEAR(
        found.poses[i].angle_deg, expected.poses[i].angle_deg, kTolerance);
  }
  const Eigen::MatrixXd& covariance = expected.refinement.covariance;
  EXPECT_LT((found.refinement.covariance - covariance).norm(),
            kPointTolerance * covariance.norm());
  ExpectNear(
      {found.refinement.noise_std_px, found.refinement.outlier_share},
      {expected.refinement.noise_std_px, expected.refinement.outlier_share});
  ExpectNear(found.stds_px, expected.stds_px, kPointTolerance);
  ExpectNear(found.rms_px, expected.rms_px, kPointTolerance);
  EXPECT_EQ(found.static_points.num_points, expected.static_points.num_points);
  EXPECT_EQ(found.static_points.num_tracks, expected.static_points.num_tracks);
  EXPECT_EQ(found.static_points.observation_share,
            expected.static_points.observation_share);
}

TEST(RefinementOverRanks, GivesWhatOneProcessGives) {
  const SceneEstimate all = MakeScene();
  for (const char* treatment : {"keep", "drop"}) {
    MultiFrameOptions options = Options();
    options.static_points = treatment;
    const Found expected = RefineCapture(options, all);
    ASSERT_TRUE(expected.refinement.converged);
    ASSERT_GT(expected.static_points.num_points, 50);
    for (const int num_ranks : {2, 3}) {
      RunRanks(num_ranks, [&](const Communicator& ranks) {
        ExpectNear(RefineCapture(options, Share(all, ranks)), expected);
      });
    }
  }
}

TEST(RefinementOverRanks, CorrectsExtrinsicsTogether) {
  MultiFrameOptions options = Options();
  options.extrinsics_rotation_std_deg = 0.02;
  options.extrinsics_translation_std = 1e-4;
  const SceneEstimate all = MakeScene();
  const Found expected = RefineCapture(options, all);
  RunRanks(2, [&](const Communicator& ranks) {
    const Found found = RefineCapture(options, Share(all, ranks));
    ExpectNear(found, expected);
    for (size_t i = 0; i < all.scene.cameras.size(); ++i) {
      EXPECT_LT(
          (found.refinement.estimate.cameras[i].cam_from_world.Center() -
           expected.refinement.estimate.cameras[i].cam_from_world.Center())
              .norm(),
          kTolerance);
    }
  });
}

// Also of the tracks that the frames of one rank share with those of another.
TEST(RefinementOverRanks, FindsStaticPointsBetweenRanks) {
  const SceneEstimate all = MakeScene();
  const TrackGroups expected = FindStaticPoints(all.scene);
  ASSERT_GT(expected.size(), 50);
  RunRanks(4, [&](const Communicator& ranks) {
    const TrackGroups found = FindStaticPoints(Share(all, ranks).scene);
    ASSERT_EQ(found.size(), expected.size());
    for (size_t g = 0; g < found.size(); ++g) {
      std::vector<size_t> point_idxs;
      for (const TrackIndex& track : expected[g]) {
        if (track.frame_idx == static_cast<size_t>(ranks.Rank())) {
          point_idxs.push_back(track.point_idx);
        }
      }
      ASSERT_EQ(found[g].size(), point_idxs.size());
      for (size_t i = 0; i < point_idxs.size(); ++i) {
        EXPECT_EQ(found[g][i].frame_idx, 0);
        EXPECT_EQ(found[g][i].point_idx, point_idxs[i]);
      }
    }
  });
}

}  // namespace
}  // namespace mfir
