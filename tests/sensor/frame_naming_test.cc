#include "src/sensor/frame_naming.h"

#include <gtest/gtest.h>

#include "src/util/errors.h"

namespace mfir {
namespace {

using Names = std::vector<std::string>;

const std::set<std::string> kCameras = {"cam1", "cam2", "7"};

TEST(FrameNames, FirstFolder) {
  EXPECT_EQ(
      FrameNames({"000/cam1.png", "000/cam2.png", "015/a/cam1.png"}, kCameras),
      Names({"000", "000", "015"}));
}

TEST(FrameNames, FirstFolderThatIsACamera) {
  EXPECT_EQ(FrameNames({"cam1/000.png", "cam2/000.png", "007/take2/015.png"},
                       kCameras),
            Names({"000", "000", "take2_015"}));
  // One is no camera of RIG.
  EXPECT_EQ(FrameNames({"cam1/000.png", "cam3/000.png"}, kCameras),
            Names({"cam1", "cam3"}));
  // Files are cameras, too.
  EXPECT_EQ(FrameNames({"7/cam1.png", "007/cam2.png"}, kCameras),
            Names({"7", "007"}));
}

TEST(FrameNames, PaperNames) {
  EXPECT_EQ(FrameNames({"camera0001_frame0002.png", "camera0001_frame0030.png"},
                       kCameras),
            Names({"0002", "0030"}));
}

TEST(FrameNames, OneFrame) {
  EXPECT_EQ(FrameNames({"cam1.png", "a/cam2.png"}, kCameras),
            Names({"frame", "frame"}));
  EXPECT_EQ(FrameNames({}, kCameras), Names());
}

TEST(FrameNames, Regex) {
  EXPECT_EQ(FrameNames({"x/cam1_t05.png", "x/cam2_t05.png", "x/other.png"},
                       kCameras,
                       "_(t\\d+)"),
            Names({"t05", "t05", ""}));
  for (const char* invalid : {"(", "t\\d+", "(t)(\\d)"}) {
    EXPECT_THROW(FrameNames({}, kCameras, invalid), UsageError) << invalid;
  }
}

TEST(FrameNames, CanBeFolders) {
  EXPECT_EQ(FrameNames({"../cam1.png", "a/cam1.png"}, kCameras),
            Names({"_..", "a"}));
  EXPECT_EQ(FrameNames({"a/b/1.png"}, kCameras, "^(.*)/1"), Names({"a_b"}));
}

TEST(NamesOfFrames, WhatTheirImagesShare) {
  EXPECT_EQ(NamesOfFrames({{"000/cam1.png", "000/cam2.png"},
                           {"015/cam1.png", "015/cam2.png"}}),
            Names({"000", "015"}));
  EXPECT_EQ(NamesOfFrames({{"cam1/000.png", "cam2/000.jpg"},
                           {"cam1/015.png", "cam2/015.png"}}),
            Names({"000", "015"}));
  EXPECT_EQ(NamesOfFrames({{"camera1_frame5.png", "camera2_frame5.png"},
                           {"camera1_frame7.png"}}),
            Names({"5", "7"}));
}

TEST(NamesOfFrames, Numbers) {
  // Nothing is shared within the second.
  EXPECT_EQ(NamesOfFrames({{"000/cam1.png", "000/cam2.png"},
                           {"015/cam1.png", "016/cam2.png"}}),
            Names({"frame1", "frame2"}));
  // Two with the same name.
  EXPECT_EQ(NamesOfFrames({{"000/cam1.png", "000/cam2.png"},
                           {"000/cam3.png", "000/cam4.png"}}),
            Names({"frame1", "frame2"}));
}

}  // namespace
}  // namespace mfir
