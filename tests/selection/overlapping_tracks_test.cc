#include "src/selection/overlapping_tracks.h"

#include <algorithm>

#include <gtest/gtest.h>

namespace mfir {
namespace {

using Group = std::vector<TrackIndex>;

constexpr size_t kNumImages = 5;

Frame EmptyFrame() {
  Frame frame;
  for (size_t i = 0; i < kNumImages; ++i) frame.images.push_back({i});
  return frame;
}

// A track in the images [begin, end), `x` px from the left in each.
void AddTrackAt(size_t begin, size_t end, double x, Frame* frame) {
  for (size_t i = begin; i < end; ++i) {
    frame->observations.push_back({i, {x, 200.0}});
  }
  frame->track_begins.push_back(frame->observations.size());
}

std::vector<std::vector<std::pair<size_t, size_t>>> AsPairs(
    const std::vector<Group>& groups) {
  std::vector<std::vector<std::pair<size_t, size_t>>> pairs;
  for (const Group& group : groups) {
    pairs.emplace_back();
    for (const auto& [frame_idx, point_idx] : group) {
      pairs.back().emplace_back(frame_idx, point_idx);
    }
  }
  return pairs;
}

using Expected = std::vector<std::vector<std::pair<size_t, size_t>>>;

TEST(GroupOverlappingTracks, JoinsNeighboursWithoutChains) {
  Scene scene;
  scene.frames = {EmptyFrame(), EmptyFrame()};
  AddTrackAt(0, 3, 100.0, &scene.frames[0]);
  AddTrackAt(0, 3, 109.0, &scene.frames[0]);  // near the first
  AddTrackAt(0, 3, 118.0, &scene.frames[0]);  // near the second only
  AddTrackAt(0, 3, 127.5, &scene.frames[0]);  // near the third, which leads
  AddTrackAt(0, 3, 300.0, &scene.frames[0]);  // alone
  AddTrackAt(0, 3, 100.0, &scene.frames[1]);  // of another frame
  EXPECT_EQ(AsPairs(GroupOverlappingTracks(scene, {})),
            (Expected{{{0, 0}, {0, 1}}, {{0, 2}, {0, 3}}}));
}

TEST(GroupOverlappingTracks, AsksForMostOfTheSharedCameras) {
  Scene scene;
  scene.frames = {EmptyFrame()};
  AddTrackAt(0, 5, 100.0, &scene.frames[0]);
  AddTrackAt(4, 5, 100.0, &scene.frames[0]);  // one camera only
  // Near in two of four, and in three of four.
  AddTrackAt(0, 2, 105.0, &scene.frames[0]);
  scene.frames[0].track_begins.pop_back();
  AddTrackAt(2, 4, 150.0, &scene.frames[0]);
  AddTrackAt(0, 3, 95.0, &scene.frames[0]);
  scene.frames[0].track_begins.pop_back();
  AddTrackAt(3, 4, 150.0, &scene.frames[0]);
  EXPECT_EQ(AsPairs(GroupOverlappingTracks(scene, {})),
            (Expected{{{0, 0}, {0, 3}}}));
}

TEST(GroupOverlappingTracks, StaticPointsStayTogether) {
  Scene scene;
  scene.frames = {EmptyFrame(), EmptyFrame()};
  AddTrackAt(0, 3, 100.0, &scene.frames[0]);
  AddTrackAt(0, 3, 108.0, &scene.frames[0]);
  AddTrackAt(0, 3, 108.2, &scene.frames[1]);
  AddTrackAt(0, 3, 400.0, &scene.frames[0]);
  AddTrackAt(0, 3, 400.1, &scene.frames[1]);
  const std::vector<Group> static_points = {{{0, 1}, {1, 0}}, {{0, 2}, {1, 1}}};
  EXPECT_EQ(AsPairs(GroupOverlappingTracks(scene, static_points)),
            (Expected{{{0, 0}, {0, 1}, {1, 0}}, {{0, 2}, {1, 1}}}));
}

// The groups do not depend on where in the grid keypoints are.
TEST(GroupOverlappingTracks, TenPixels) {
  for (double offset = -12.0; offset < 12.0; offset += 1.0) {
    for (const double distance : {9.9, 10.1}) {
      Scene scene;
      scene.frames = {EmptyFrame()};
      AddTrackAt(0, 2, offset, &scene.frames[0]);
      AddTrackAt(0, 2, offset + distance, &scene.frames[0]);
      EXPECT_EQ(GroupOverlappingTracks(scene, {}).size(),
                distance < 10.0 ? 1 : 0)
          << offset;
    }
  }
}

}  // namespace
}  // namespace mfir
