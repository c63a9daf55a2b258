#include "src/refinement/held_out_tracks.h"

#include <gtest/gtest.h>

namespace mfir {
namespace {

Scene MakeScene(const std::string& frame_name, size_t num_tracks) {
  Scene scene;
  scene.cameras.resize(2);
  Frame frame;
  frame.name = frame_name;
  frame.images = {{0, {}, {}}, {1, {}, {}}};
  for (size_t i = 0; i < num_tracks; ++i) {
    frame.points.push_back({static_cast<double>(i), 0.0, 1.0});
    frame.observations.push_back({0, {3.0 * i, 5.0}});
    frame.observations.push_back({1, {2.0 * i, 7.0}});
    frame.track_begins.push_back(frame.observations.size());
  }
  scene.frames.push_back(frame);
  return scene;
}

TEST(HeldOutTracks, TakesTheShareAndPutsItBack) {
  Scene scene = MakeScene("frame", 1000);
  const HeldOutTracks held_out(0.2, &scene);
  EXPECT_NEAR(scene.frames[0].points.size(), 800.0, 50.0);
  EXPECT_EQ(scene.frames[0].observations.size(),
            2 * scene.frames[0].points.size());
  held_out.PutBack(&scene);
  ASSERT_EQ(scene.frames[0].points.size(), 1000u);
  for (size_t i = 0; i < 1000; ++i) {
    EXPECT_EQ(scene.frames[0].points[i].x(), i);
  }
}

TEST(HeldOutTracks, OrderOfObservationsDoesNotMatter) {
  Scene scene = MakeScene("frame", 1000);
  Scene turned = scene;
  for (size_t i = 0; i < 1000; ++i) {
    std::swap(turned.frames[0].observations[2 * i],
              turned.frames[0].observations[2 * i + 1]);
  }
  const HeldOutTracks held_out(0.2, &scene);
  const HeldOutTracks held_out_turned(0.2, &turned);
  ASSERT_EQ(scene.frames[0].points.size(), turned.frames[0].points.size());
  EXPECT_EQ(scene.frames[0].points, turned.frames[0].points);
}

// Eighths of a pixel are halves of a hundredth.
TEST(HeldOutTracks, LastDigitsDoNotMatter) {
  Scene scene = MakeScene("frame", 1000);
  for (Observation& observation : scene.frames[0].observations) {
    observation.xy.array() += 0.125;
  }
  Scene moved = scene;
  for (Observation& observation : moved.frames[0].observations) {
    observation.xy.array() -= 1e-9;
  }
  const HeldOutTracks held_out(0.2, &scene);
  const HeldOutTracks held_out_moved(0.2, &moved);
  ASSERT_EQ(scene.frames[0].points.size(), moved.frames[0].points.size());
  EXPECT_EQ(scene.frames[0].points, moved.frames[0].points);
}

// Of captures of a single track every other one would lose it.
TEST(HeldOutTracks, SomethingIsLeftToRefineWith) {
  for (int i = 0; i < 20; ++i) {
    Scene scene = MakeScene("frame" + std::to_string(i), 1);
    const HeldOutTracks held_out(0.5, &scene);
    EXPECT_EQ(scene.frames[0].points.size(), 1u);
  }
}

}  // namespace
}  // namespace mfir
