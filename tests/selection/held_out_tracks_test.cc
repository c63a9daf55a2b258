#include "src/selection/held_out_tracks.h"

#include <algorithm>

#include <gtest/gtest.h>

namespace mfir {
namespace {

Scene MakeScene(size_t num_tracks, double x = 0.0) {
  Scene scene;
  scene.cameras.resize(2);
  Frame frame;
  frame.name = "frame";
  frame.images = {{0}, {1}};
  for (size_t i = 0; i < num_tracks; ++i) {
    frame.observations.push_back({0, {x + 3.0 * i, 5.0}});
    frame.observations.push_back({1, {2.0 * i, 7.0}});
    frame.track_begins.push_back(frame.observations.size());
  }
  scene.frames.push_back(frame);
  return scene;
}

std::vector<TrackRole> Roles(double share, const Scene& scene) {
  return HoldOutTracks(share, scene, FittedTracks(scene)).roles[0];
}

TEST(HeldOutTracks, AreTheShare) {
  const std::vector<TrackRole> roles = Roles(0.2, MakeScene(1000));
  ASSERT_EQ(roles.size(), 1000u);
  EXPECT_NEAR(
      std::count(roles.begin(), roles.end(), TrackRole::kFitted), 800.0, 50.0);
  EXPECT_EQ(std::count(roles.begin(), roles.end(), TrackRole::kFitted) +
                std::count(roles.begin(), roles.end(), TrackRole::kHeldOut),
            1000);
}

TEST(HeldOutTracks, AreNotTakenFromOthers) {
  const Scene scene = MakeScene(1000);
  Selection selection = FittedTracks(scene);
  std::fill_n(selection.roles[0].begin(), 500, TrackRole::kDropped);
  const Selection held_out = HoldOutTracks(0.5, scene, selection);
  EXPECT_TRUE(std::equal(selection.roles[0].begin(),
                         selection.roles[0].begin() + 500,
                         held_out.roles[0].begin()));
  EXPECT_NEAR(std::count(held_out.roles[0].begin(),
                         held_out.roles[0].end(),
                         TrackRole::kHeldOut),
              250.0,
              40.0);
}

TEST(HeldOutTracks, MergedTracksToo) {
  const Scene scene = MakeScene(1);
  Selection selection = FittedTracks(scene);
  MergedTrack merged;
  for (int i = 0; i < 1000; ++i) {
    merged.observations = {{0, {4.0 * i, 9.0}}, {1, {3.0 * i, 2.0}}};
    selection.merged.push_back(merged);
  }
  size_t num_held_out = 0;
  for (const MergedTrack& track : HoldOutTracks(0.2, scene, selection).merged) {
    num_held_out += track.role == TrackRole::kHeldOut;
  }
  EXPECT_NEAR(num_held_out, 200.0, 50.0);
}

TEST(HeldOutTracks, OrderOfObservationsDoesNotMatter) {
  const Scene scene = MakeScene(1000);
  Scene turned = scene;
  for (size_t i = 0; i < 1000; ++i) {
    std::swap(turned.frames[0].observations[2 * i],
              turned.frames[0].observations[2 * i + 1]);
  }
  EXPECT_EQ(Roles(0.2, scene), Roles(0.2, turned));
}

// The same capture in another layout: its frames have other names.
TEST(HeldOutTracks, NamesOfFramesDoNotMatter) {
  const Scene scene = MakeScene(1000);
  Scene renamed = scene;
  renamed.frames[0].name = "000000";
  EXPECT_EQ(Roles(0.2, scene), Roles(0.2, renamed));
}

// Eighths of a pixel are halves of a hundredth.
TEST(HeldOutTracks, LastDigitsDoNotMatter) {
  Scene scene = MakeScene(1000);
  for (Observation& observation : scene.frames[0].observations) {
    observation.xy.array() += 0.125;
  }
  Scene moved = scene;
  for (Observation& observation : moved.frames[0].observations) {
    observation.xy.array() -= 1e-9;
  }
  EXPECT_EQ(Roles(0.2, scene), Roles(0.2, moved));
}

// Of captures of a single track every other one would lose it.
TEST(HeldOutTracks, SomethingIsLeftToRefineWith) {
  for (int i = 0; i < 20; ++i) {
    const Scene scene = MakeScene(1, 10.0 * i);
    EXPECT_EQ(Roles(0.5, scene), std::vector<TrackRole>{TrackRole::kFitted});
  }
}

}  // namespace
}  // namespace mfir
