#include "src/selection/static_points.h"

#include <cmath>

#include <gtest/gtest.h>

#include "src/refinement/initial_intrinsics.h"
#include "src/refinement/refinement.h"
#include "src/selection/held_out_tracks.h"
#include "src/selection/static_point_search.h"
#include "src/util/errors.h"
#include "tests/support/test_scenes.h"

namespace mfir {
namespace {

constexpr size_t kNumFrames = 3;
constexpr size_t kNumMoving = 40;  // per frame
constexpr size_t kNumStatic = 60;

void Jitter(double sigma, Random* random, Frame* frame) {
  for (Observation& observation : frame->observations) {
    observation.xy +=
        Eigen::Vector2d(random->Normal(0.0, sigma), random->Normal(0.0, sigma));
  }
}

// The frame `num_frames` times, with other errors of the keypoints (px).
SceneEstimate Repeat(const SceneEstimate& one,
                     size_t num_frames,
                     double jitter) {
  Random random({5});
  SceneEstimate repeated = one;
  repeated.scene.frames.assign(num_frames, one.scene.frames[0]);
  repeated.estimate.frames.assign(num_frames, one.estimate.frames[0]);
  for (size_t f = 0; f < num_frames; ++f) {
    repeated.scene.frames[f].name = "frame" + std::to_string(f);
    Jitter(jitter, &random, &repeated.scene.frames[f]);
  }
  return repeated;
}

// Frames with kNumMoving points of their own, then kNumStatic common ones.
TestScene MakeStaticScene(double jitter, const TestSceneOptions& base = {}) {
  TestSceneOptions options = base;
  options.num_frames = kNumFrames + 1;
  options.num_points = kNumMoving + kNumStatic;
  TestScene result = MakeTestScene(options);
  for (SceneEstimate* capture : {&result.truth, &result.start}) {
    Random random({6});
    const Frame common = capture->scene.frames.back();
    const FrameEstimate common_estimate = capture->estimate.frames.back();
    const size_t num_observations = common.track_begins[kNumStatic];
    capture->scene.frames.pop_back();
    capture->estimate.frames.pop_back();
    for (size_t f = 0; f < kNumFrames; ++f) {
      Frame& frame = capture->scene.frames[f];
      Frame repeated = common;
      Jitter(capture == &result.truth ? 0.0 : jitter, &random, &repeated);
      frame.track_begins.resize(kNumMoving + 1);
      frame.observations.resize(frame.track_begins.back());
      for (size_t i = 1; i <= kNumStatic; ++i) {
        frame.track_begins.push_back(frame.track_begins[kNumMoving] +
                                     common.track_begins[i]);
      }
      frame.observations.insert(
          frame.observations.end(),
          repeated.observations.begin(),
          repeated.observations.begin() +
              static_cast<std::ptrdiff_t>(num_observations));
      std::vector<Eigen::Vector3d>& points = capture->estimate.frames[f].points;
      points.resize(kNumMoving);
      points.insert(points.end(),
                    common_estimate.points.begin(),
                    common_estimate.points.begin() + kNumStatic);
    }
  }
  return result;
}

// Of camera i.
Eigen::Vector2d Keypoint(size_t i) {
  return {100.0 + 10.0 * static_cast<double>(i), 200.0};
}

// A track in the images [begin, end).
void AddTrack(size_t begin, size_t end, double shift, Frame* frame) {
  for (size_t i = begin; i < end; ++i) {
    frame->observations.push_back(
        {i,
         Keypoint(i) + Eigen::Vector2d(shift, 0.0),
         static_cast<uint32_t>(10 * frame->NumPoints() + i)});
  }
  frame->track_begins.push_back(frame->observations.size());
}

// Frames without tracks.
Scene EmptyScene(size_t num_frames, size_t num_cameras) {
  Scene scene;
  scene.cameras.resize(num_cameras);
  scene.frames.resize(num_frames);
  for (Frame& frame : scene.frames) {
    for (size_t i = 0; i < num_cameras; ++i) {
      frame.images.push_back({i});
    }
  }
  return scene;
}

size_t NumTracks(const Scene& scene) {
  size_t count = 0;
  for (const Frame& frame : scene.frames) count += frame.NumPoints();
  return count;
}

void ExpectSameTracks(const Frame& a, const Frame& b) {
  ASSERT_EQ(a.track_begins, b.track_begins);
  for (size_t k = 0; k < b.observations.size(); ++k) {
    EXPECT_EQ(a.observations[k].xy, b.observations[k].xy);
    EXPECT_EQ(a.observations[k].image_idx, b.observations[k].image_idx);
    EXPECT_EQ(a.observations[k].keypoint_idx, b.observations[k].keypoint_idx);
  }
}

MultiFrameOptions Options() {
  MultiFrameOptions options;
  options.ApplyPreset("accurate");
  options.num_threads = 2;
  return options;
}

// Standard deviations of all intrinsics.
Eigen::VectorXd RefinedStds(SceneEstimate start) {
  start = InitializeIntrinsics(Options(), std::move(start));
  return RefineFixedExtrinsics(
             Options(), true, [](const Stage&) {}, start.scene, start.estimate)
      .covariance.diagonal()
      .cwiseSqrt();
}

// An estimate without meaning for a scene.
Estimate EmptyEstimate(const Scene& scene) {
  Estimate estimate;
  estimate.cameras = scene.cameras;
  for (const Frame& frame : scene.frames) {
    FrameEstimate& frame_estimate = estimate.frames.emplace_back();
    frame_estimate.images.resize(frame.images.size());
    frame_estimate.points.resize(frame.NumPoints(), Eigen::Vector3d::Zero());
  }
  return estimate;
}

// The scene that is fitted.
Scene Fitted(const std::string& treatment,
             const Scene& scene,
             StaticPointStatistics* statistics) {
  return SelectTracks(SelectStaticPoints(treatment, scene, statistics),
                      TrackRole::kFitted,
                      scene,
                      EmptyEstimate(scene))
      .scene;
}

TEST(FindStaticPoints, FindsCopiesAndNothingThatMoves) {
  const Scene scene = MakeStaticScene(0.2).start.scene;
  const auto points = FindStaticPoints(scene);
  ASSERT_EQ(points.size(), kNumStatic);
  for (size_t i = 0; i < points.size(); ++i) {
    ASSERT_EQ(points[i].size(), kNumFrames);
    for (size_t f = 0; f < kNumFrames; ++f) {
      EXPECT_EQ(points[i][f].frame_idx, f);
      EXPECT_EQ(points[i][f].point_idx, kNumMoving + i);
    }
  }
}

TEST(FindStaticPoints, AgreeInTwoCamerasAndMostOfThoseShared) {
  // Cameras that agree and disagree.
  const auto is_found = [](size_t num_agreeing, size_t num_others) {
    Scene scene = EmptyScene(2, 8);
    for (Frame& frame : scene.frames) {
      AddTrack(0, num_agreeing + num_others, 0.0, &frame);
    }
    Frame& frame = scene.frames[1];
    for (size_t k = 0; k < num_others; ++k) frame.observations[k].xy.y() += 1.1;
    return !FindStaticPoints(scene).empty();
  };
  EXPECT_FALSE(is_found(1, 0));
  EXPECT_TRUE(is_found(2, 0));
  EXPECT_TRUE(is_found(2, 1));
  EXPECT_FALSE(is_found(2, 2));
  EXPECT_TRUE(is_found(3, 2));
  EXPECT_FALSE(is_found(0, 8));
}

TEST(FindStaticPoints, OtherCamerasAreNoContradiction) {
  Scene scene = EmptyScene(2, 8);
  AddTrack(0, 5, 0.0, &scene.frames[0]);
  AddTrack(3, 8, 0.9, &scene.frames[1]);
  EXPECT_EQ(FindStaticPoints(scene).size(), 1);
  // The order of the images is free.
  std::reverse(scene.frames[1].images.begin(), scene.frames[1].images.end());
  EXPECT_TRUE(FindStaticPoints(scene).empty());
  for (Observation& observation : scene.frames[1].observations) {
    observation.image_idx = 7 - observation.image_idx;
  }
  EXPECT_EQ(FindStaticPoints(scene).size(), 1);
}

TEST(FindStaticPoints, JoinsThePartsOfATrack) {
  Scene scene = EmptyScene(3, 8);
  AddTrack(0, 4, 0.0, &scene.frames[0]);
  AddTrack(4, 8, 0.0, &scene.frames[0]);
  AddTrack(0, 8, 0.1, &scene.frames[1]);
  AddTrack(4, 8, 0.2, &scene.frames[2]);
  const auto points = FindStaticPoints(scene);
  ASSERT_EQ(points.size(), 1);
  EXPECT_EQ(points[0].size(), 4);
  // In one frame alone: no repetition.
  scene.frames.resize(1);
  EXPECT_TRUE(FindStaticPoints(scene).empty());
}

TEST(FindStaticPoints, SlowMotionIsMotion) {
  Scene scene = EmptyScene(10, 3);
  for (size_t f = 0; f < scene.frames.size(); ++f) {
    AddTrack(0, 3, 0.6 * static_cast<double>(f), &scene.frames[f]);
  }
  for (const auto& tracks : FindStaticPoints(scene)) {
    EXPECT_EQ(tracks.size(), 2);
  }
}

TEST(FindStaticPoints, GapsHaveALimit) {
  // Shown every `step` frames.
  const auto sizes = [](size_t step) {
    Scene scene = EmptyScene(6 * kMaxStaticGap, 3);
    for (size_t f = 0; f < scene.frames.size(); f += step) {
      AddTrack(0, 3, 0.0, &scene.frames[f]);
    }
    std::vector<size_t> sizes;
    for (const auto& tracks : FindStaticPoints(scene)) {
      sizes.push_back(tracks.size());
    }
    return sizes;
  };
  EXPECT_EQ(sizes(1), std::vector<size_t>{6 * kMaxStaticGap});
  EXPECT_EQ(sizes(kMaxStaticGap), std::vector<size_t>{6});
  EXPECT_TRUE(sizes(kMaxStaticGap + 1).empty());
}

TEST(FindStaticPoints, CellsHaveNoBorders) {
  for (double x = -6.0; x < 6.0; x += 0.25) {
    for (const double shift : {-0.95, 0.95}) {
      Scene scene = EmptyScene(2, 2);
      AddTrack(0, 2, x - 100.0, &scene.frames[0]);
      AddTrack(0, 2, x - 100.0 + shift, &scene.frames[1]);
      EXPECT_EQ(FindStaticPoints(scene).size(), 1) << x << " " << shift;
    }
  }
}

TEST(StaticPoints, MergedTrackHasTheMediansOfAllCameras) {
  Scene scene = EmptyScene(3, 6);
  AddTrack(0, 3, 0.0, &scene.frames[0]);
  AddTrack(0, 5, 0.1, &scene.frames[1]);
  AddTrack(0, 5, 0.5, &scene.frames[2]);
  AddTrack(1, 6, 300.0, &scene.frames[1]);
  AddTrack(2, 6, 0.3, &scene.frames[2]);
  StaticPointStatistics statistics;
  const Scene fitted = Fitted("merge", scene, &statistics);
  EXPECT_EQ(statistics.num_points, 1);
  EXPECT_EQ(statistics.num_tracks, 4);
  EXPECT_DOUBLE_EQ(statistics.observation_share, 17.0 / 22.0);
  EXPECT_EQ(fitted.frames[0].NumPoints(), 0);
  EXPECT_EQ(fitted.frames[1].NumPoints(), 1);
  // Frame 2 sees it in all cameras.
  const Frame& frame = fitted.frames[2];
  ASSERT_EQ(frame.track_begins, (std::vector<size_t>{0, 6}));
  for (size_t i = 0; i < 6; ++i) {
    const Observation& observation = frame.observations[i];
    EXPECT_EQ(observation.image_idx, i);
    EXPECT_EQ(observation.keypoint_idx, i == 5 ? 15 : i);
    const double expected[] = {0.1, 0.1, 0.2, 0.3, 0.3, 0.3};
    EXPECT_NEAR(observation.xy.x(), Keypoint(i).x() + expected[i], 1e-9) << i;
    EXPECT_EQ(observation.xy.y(), 200.0);
  }
}

TEST(StaticPoints, MergedTrackIsWhereTheImagesAre) {
  Scene scene = EmptyScene(2, 6);
  AddTrack(0, 3, 0.0, &scene.frames[0]);
  AddTrack(0, 5, 0.0, &scene.frames[1]);
  // Frame 0 has all images but keypoints in three of them only; frame 1 has no
  // image of camera 0.
  Frame& frame = scene.frames[1];
  frame.images.erase(frame.images.begin());
  frame.observations.erase(frame.observations.begin());
  for (Observation& observation : frame.observations) --observation.image_idx;
  frame.track_begins = {0, 4};
  StaticPointStatistics statistics;
  const Scene fitted = Fitted("merge", scene, &statistics);
  EXPECT_EQ(fitted.frames[1].NumPoints(), 0);
  ASSERT_EQ(fitted.frames[0].observations.size(), 5);
  EXPECT_EQ(fitted.frames[0].observations[2].keypoint_idx, 2);
  EXPECT_EQ(fitted.frames[0].observations[4].keypoint_idx, kNoKeypoint);
}

void ExpectRatios(const Eigen::VectorXd& values,
                  const Eigen::VectorXd& expected,
                  double ratio,
                  double tolerance) {
  const Eigen::VectorXd ratios = values.cwiseQuotient(expected);
  EXPECT_GT(ratios.minCoeff(), ratio * (1.0 - tolerance));
  EXPECT_LT(ratios.maxCoeff(), ratio * (1.0 + tolerance));
}

TEST(StaticPoints, CountOnceInTheUncertainty) {
  TestSceneOptions options;
  options.num_frames = 1;
  options.num_points = 200;
  const SceneEstimate one = MakeTestScene(options).start;
  const Eigen::VectorXd expected = RefinedStds(one);
  const SceneEstimate repeated = Repeat(one, 3, 0.02);
  ExpectRatios(RefinedStds(repeated), expected, 1.0, 0.03);
  StaticPointStatistics statistics;
  const SceneEstimate merged =
      SelectTracks(SelectStaticPoints("merge", repeated.scene, &statistics),
                   TrackRole::kFitted,
                   repeated.scene,
                   repeated.estimate);
  EXPECT_EQ(NumTracks(merged.scene), 200);
  ExpectRatios(RefinedStds(merged), expected, 1.0, 0.03);
}

TEST(StaticPoints, DropLeavesWhatMoves) {
  const Scene scene = MakeStaticScene(0.2).start.scene;
  Scene moving = scene;
  for (Frame& frame : moving.frames) {
    frame.track_begins.resize(kNumMoving + 1);
    frame.observations.resize(frame.track_begins.back());
  }
  StaticPointStatistics statistics;
  const Scene fitted = Fitted("drop", scene, &statistics);
  EXPECT_EQ(statistics.num_points, kNumStatic);
  EXPECT_DOUBLE_EQ(statistics.observation_share, 0.6);
  for (size_t f = 0; f < kNumFrames; ++f) {
    ExpectSameTracks(fitted.frames[f], moving.frames[f]);
  }
}

TEST(StaticPoints, DropNeedsSomethingThatMoves) {
  TestSceneOptions options;
  options.num_frames = 1;
  const Scene scene = Repeat(MakeTestScene(options).start, 2, 0.1).scene;
  StaticPointStatistics statistics;
  EXPECT_THROW(SelectStaticPoints("drop", scene, &statistics), InputError);
  EXPECT_EQ(NumTracks(Fitted("merge", scene, &statistics)), 100);
  EXPECT_EQ(statistics.observation_share, 1.0);
}

TEST(Selection, JoinsWhatItHasSelected) {
  const SceneEstimate all = MakeStaticScene(0.2).start;
  for (const char* treatment : {"merge", "drop", "keep"}) {
    StaticPointStatistics statistics;
    const Selection selection = HoldOutTracks(
        0.2, all.scene, SelectStaticPoints(treatment, all.scene, &statistics));
    size_t num_selected = 0;
    Estimate joined = EmptyEstimate(all.scene);
    for (const TrackRole role : {TrackRole::kFitted,
                                 TrackRole::kHeldOut,
                                 TrackRole::kMerged,
                                 TrackRole::kDropped}) {
      const SceneEstimate selected =
          SelectTracks(selection, role, all.scene, all.estimate);
      num_selected += NumTracks(selected.scene);
      joined =
          JoinEstimates(selection, role, selected.estimate, std::move(joined));
    }
    EXPECT_EQ(num_selected, NumTracks(all.scene) + selection.merged.size());
    for (size_t f = 0; f < kNumFrames; ++f) {
      EXPECT_EQ(joined.frames[f].points, all.estimate.frames[f].points);
    }
  }
}

TEST(FitPoints, PointsFitTheRefinedCameras) {
  TestSceneOptions options;
  options.noise = 0.0;
  const TestScene setup = MakeStaticScene(0.0, options);
  Estimate refined = setup.start.estimate;
  refined.cameras = setup.truth.estimate.cameras;
  const Estimate fitted = FitPoints(Options(), setup.start.scene, refined);
  for (size_t f = 0; f < kNumFrames; ++f) {
    const std::vector<Eigen::Vector3d>& truth =
        setup.truth.estimate.frames[f].points;
    for (size_t i = 0; i < truth.size(); ++i) {
      EXPECT_LT((fitted.frames[f].points[i] - truth[i]).norm(), 1e-8);
    }
    EXPECT_GT((refined.frames[f].points[0] - truth[0]).norm(), 1e-4);
  }
  for (size_t i = 0; i < refined.cameras.size(); ++i) {
    EXPECT_EQ(fitted.cameras[i].params, refined.cameras[i].params);
  }
}

}  // namespace
}  // namespace mfir
