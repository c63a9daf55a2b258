#include "src/refinement/static_points.h"
#include "src/scene/static_point_search.h"

#include <cmath>

#include <gtest/gtest.h>

#include "src/refinement/refinement.h"
#include "src/util/errors.h"
#include "tests/support/test_scenes.h"

namespace mfir {
namespace {

constexpr size_t kNumFrames = 3;
constexpr size_t kNumMoving = 40;  // per frame
constexpr size_t kNumStatic = 60;

void AppendTrack(const Frame& source, size_t point_idx, Frame* target) {
  target->points.push_back(source.points[point_idx]);
  target->observations.insert(
      target->observations.end(),
      source.observations.begin() + source.track_begins[point_idx],
      source.observations.begin() + source.track_begins[point_idx + 1]);
  target->track_begins.push_back(target->observations.size());
}

void Jitter(double sigma, Random* random, Frame* frame) {
  for (Observation& observation : frame->observations) {
    observation.xy +=
        Eigen::Vector2d(random->Normal(0.0, sigma), random->Normal(0.0, sigma));
  }
}

// The frame `num_frames` times, with other errors of the keypoints (px).
Scene Repeat(const Scene& scene, size_t num_frames, double jitter) {
  Random random({5});
  Scene repeated = scene;
  repeated.frames.assign(num_frames, scene.frames[0]);
  for (size_t f = 0; f < num_frames; ++f) {
    repeated.frames[f].name = "frame" + std::to_string(f);
    Jitter(jitter, &random, &repeated.frames[f]);
  }
  return repeated;
}

// Frames with kNumMoving points of their own, then kNumStatic common ones.
TestScene MakeStaticScene(double jitter, const TestSceneOptions& base = {}) {
  TestSceneOptions options = base;
  options.num_frames = kNumFrames + 1;
  options.num_points = kNumMoving + kNumStatic;
  TestScene result = MakeTestScene(options);
  for (Scene* scene : {&result.truth, &result.start}) {
    Random random({6});
    const Frame common = scene->frames.back();
    scene->frames.pop_back();
    for (Frame& frame : scene->frames) {
      frame.points.resize(kNumMoving);
      frame.track_begins.resize(kNumMoving + 1);
      frame.observations.resize(frame.track_begins.back());
      Frame repeated = common;
      Jitter(scene == &result.truth ? 0.0 : jitter, &random, &repeated);
      for (size_t i = 0; i < kNumStatic; ++i) AppendTrack(repeated, i, &frame);
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
         static_cast<uint32_t>(10 * frame->points.size() + i)});
  }
  frame->points.emplace_back(shift, 0.0, 1.0);
  frame->track_begins.push_back(frame->observations.size());
}

// Frames without tracks.
Scene EmptyScene(size_t num_frames, size_t num_cameras) {
  Scene scene;
  scene.cameras.resize(num_cameras);
  scene.frames.resize(num_frames);
  for (Frame& frame : scene.frames) {
    for (size_t i = 0; i < num_cameras; ++i) {
      frame.images.push_back({i, Rigid3(), {}});
    }
  }
  return scene;
}

size_t NumTracks(const Scene& scene) {
  size_t count = 0;
  for (const Frame& frame : scene.frames) count += frame.points.size();
  return count;
}

void ExpectSameTracks(const Frame& a, const Frame& b) {
  ASSERT_EQ(a.track_begins, b.track_begins);
  for (size_t i = 0; i < b.points.size(); ++i) {
    EXPECT_EQ(a.points[i], b.points[i]);
  }
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
Eigen::VectorXd RefinedStds(Scene scene) {
  InitializeIntrinsics(Options(), &scene);
  return RefineFixedExtrinsics(
             Options(), true, [](const Stage&) {}, &scene)
      .covariance.diagonal()
      .cwiseSqrt();
}

TEST(FindStaticPoints, FindsCopiesAndNothingThatMoves) {
  const Scene scene = MakeStaticScene(0.2).start;
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
  const StaticPoints static_points("merge", &scene);
  EXPECT_EQ(static_points.NumPoints(), 1);
  EXPECT_EQ(static_points.NumTracks(), 4);
  EXPECT_DOUBLE_EQ(static_points.ObservationShare(), 17.0 / 22.0);
  EXPECT_TRUE(scene.frames[0].points.empty());
  EXPECT_TRUE(scene.frames[1].points.size() == 1);
  // Frame 2 sees it in all cameras.
  const Frame& frame = scene.frames[2];
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
  const StaticPoints static_points("merge", &scene);
  EXPECT_TRUE(scene.frames[1].points.empty());
  ASSERT_EQ(scene.frames[0].observations.size(), 5);
  EXPECT_EQ(scene.frames[0].observations[2].keypoint_idx, 2);
  EXPECT_EQ(scene.frames[0].observations[4].keypoint_idx, kNoKeypoint);
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
  const Scene one = MakeTestScene(options).start;
  const Eigen::VectorXd expected = RefinedStds(one);
  Scene scene = Repeat(one, 3, 0.02);
  ExpectRatios(RefinedStds(scene), expected, 1.0, 0.03);
  const StaticPoints static_points("merge", &scene);
  EXPECT_EQ(NumTracks(scene), 200);
  ExpectRatios(RefinedStds(scene), expected, 1.0, 0.03);
}

TEST(StaticPoints, DropLeavesWhatMoves) {
  Scene scene = MakeStaticScene(0.2).start;
  Scene moving = scene;
  for (Frame& frame : moving.frames) {
    frame.points.resize(kNumMoving);
    frame.track_begins.resize(kNumMoving + 1);
    frame.observations.resize(frame.track_begins.back());
  }
  const StaticPoints static_points("drop", &scene);
  EXPECT_EQ(static_points.NumPoints(), kNumStatic);
  EXPECT_DOUBLE_EQ(static_points.ObservationShare(), 0.6);
  for (size_t f = 0; f < kNumFrames; ++f) {
    ExpectSameTracks(scene.frames[f], moving.frames[f]);
  }
}

TEST(StaticPoints, DropNeedsSomethingThatMoves) {
  TestSceneOptions options;
  options.num_frames = 1;
  const Scene repeated = Repeat(MakeTestScene(options).start, 2, 0.1);
  Scene scene = repeated;
  EXPECT_THROW(StaticPoints("drop", &scene), InputError);
  EXPECT_EQ(StaticPoints("merge", &scene).ObservationShare(), 1.0);
  EXPECT_EQ(NumTracks(scene), 100);
}

TEST(StaticPoints, AllTracksComeBack) {
  const Scene before = MakeStaticScene(0.2).start;
  for (const char* treatment : {"merge", "drop", "keep"}) {
    Scene scene = before;
    const StaticPoints static_points(treatment, &scene);
    const size_t num_left = std::string(treatment) == "drop"
                                ? kNumFrames * kNumMoving
                            : std::string(treatment) == "merge"
                                ? kNumFrames * kNumMoving + kNumStatic
                                : NumTracks(before);
    EXPECT_EQ(NumTracks(scene), num_left) << treatment;
    static_points.PutBack(&scene);
    for (size_t f = 0; f < kNumFrames; ++f) {
      ExpectSameTracks(scene.frames[f], before.frames[f]);
    }
  }
}

TEST(StaticPoints, PointsFitTheRefinedCameras) {
  TestSceneOptions options;
  options.noise = 0.0;
  const TestScene setup = MakeStaticScene(0.0, options);
  Scene scene = setup.start;
  StaticPoints static_points("merge", &scene);
  scene.cameras = setup.truth.cameras;
  static_points.FitPoints(Options(), scene);
  static_points.PutBack(&scene);
  for (size_t f = 0; f < kNumFrames; ++f) {
    const Frame& truth = setup.truth.frames[f];
    const Frame& frame = scene.frames[f];
    for (size_t i = kNumMoving; i < truth.points.size(); ++i) {
      EXPECT_LT((frame.points[i] - truth.points[i]).norm(), 1e-8);
    }
    EXPECT_GT((frame.points[0] - truth.points[0]).norm(), 1e-4);
  }
}

}  // namespace
}  // namespace mfir
