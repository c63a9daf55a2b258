#include "src/selection/frame_choice.h"

#include <gtest/gtest.h>

namespace mfir {
namespace {

using Frames = std::vector<size_t>;

TEST(FrameChoice, IsTheMiddleOfEachPart) {
  EXPECT_EQ(ChooseFrames(10, 1), Frames({5}));
  EXPECT_EQ(ChooseFrames(10, 2), Frames({2, 7}));
  EXPECT_EQ(ChooseFrames(10, 3), Frames({1, 5, 8}));
  EXPECT_EQ(ChooseFrames(10, 5), Frames({1, 3, 5, 7, 9}));
}

TEST(FrameChoice, IsAllFramesWithoutALimitOrBelowIt) {
  EXPECT_EQ(ChooseFrames(4, 0), Frames({0, 1, 2, 3}));
  EXPECT_EQ(ChooseFrames(4, 4), Frames({0, 1, 2, 3}));
  EXPECT_EQ(ChooseFrames(4, 9), Frames({0, 1, 2, 3}));
  EXPECT_TRUE(ChooseFrames(0, 3).empty());
}

TEST(FrameChoice, HasAsManyFramesAsAskedForAndNoneTwice) {
  for (size_t num_frames = 1; num_frames < 50; ++num_frames) {
    for (size_t limit = 1; limit <= num_frames; ++limit) {
      const Frames chosen = ChooseFrames(num_frames, limit);
      ASSERT_EQ(chosen.size(), limit);
      for (size_t i = 1; i < limit; ++i) ASSERT_LT(chosen[i - 1], chosen[i]);
      ASSERT_LT(chosen.back(), num_frames);
    }
  }
}

}  // namespace
}  // namespace mfir
