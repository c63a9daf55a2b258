#include "src/sensor/image_layout.h"

#include <algorithm>

#include "tests/support/test_files.h"

namespace mfir {
namespace {

using Located = std::vector<std::vector<std::string>>;

const std::vector<std::string> kRig = {"cam_1", "cam_11", "7"};

// path, frame, camera
Located Locate(const std::vector<std::string>& paths,
               const std::string& camera_regex = "",
               const std::string& frame_regex = "",
               const std::vector<std::string>& rig = kRig) {
  Located located;
  for (const LocatedImage& image :
       FindImageLayout(paths, rig, CameraNaming(camera_regex), frame_regex)
           .images) {
    located.push_back({image.path, image.frame, image.camera});
  }
  return located;
}

ImageLayout Layout(const std::vector<std::string>& paths,
                   const std::vector<std::string>& rig = kRig,
                   const std::string& frame_regex = "") {
  return FindImageLayout(paths, rig, CameraNaming(), frame_regex).layout;
}

TEST(ImageLayout, ByFrame) {
  EXPECT_EQ(Locate({"f0/cam_1.png", "f0/cam_11.png", "f1/007.png"}),
            Located({{"f0/cam_1.png", "f0", "cam_1"},
                     {"f0/cam_11.png", "f0", "cam_11"},
                     {"f1/007.png", "f1", "7"}}));
  EXPECT_EQ(Locate({"f0/f0_cam_1.png", "f0/f0_cam_11.png"}),
            Located({{"f0/f0_cam_1.png", "f0", "cam_1"},
                     {"f0/f0_cam_11.png", "f0", "cam_11"}}));
}

TEST(ImageLayout, ByCamera) {
  EXPECT_EQ(Locate({"cam_1/000.png", "cam_11/000.png", "007/001.png"}),
            Located({{"cam_1/000.png", "000", "cam_1"},
                     {"cam_11/000.png", "000", "cam_11"},
                     {"007/001.png", "001", "7"}}));
  EXPECT_EQ(Locate({"cam_1/cam_1_rgb5.jpg", "cam_11/cam_11_rgb5.jpg"}),
            Located({{"cam_1/cam_1_rgb5.jpg", "rgb5", "cam_1"},
                     {"cam_11/cam_11_rgb5.jpg", "rgb5", "cam_11"}}));
}

TEST(ImageLayout, Flat) {
  EXPECT_EQ(Layout({"cam_1_000.png"}), ImageLayout::kFlatCameraFirst);
  EXPECT_EQ(Locate({"cam_1_000.png", "cam_11-000.png", "notes.png"}),
            Located({{"cam_1_000.png", "000", "cam_1"},
                     {"cam_11-000.png", "000", "cam_11"}}));
  EXPECT_EQ(Layout({"take_2_cam_1.png"}), ImageLayout::kFlatFrameFirst);
  EXPECT_EQ(Locate({"take_2_cam_1.png", "take_2_cam_11.png"}),
            Located({{"take_2_cam_1.png", "take_2", "cam_1"},
                     {"take_2_cam_11.png", "take_2", "cam_11"}}));
  // The paper's names.
  EXPECT_EQ(Locate({"camera0007_frame12.png"}),
            Located({{"camera0007_frame12.png", "frame12", "7"}}));
}

TEST(ImageLayout, NothingFits) {
  const ImageReading reading =
      FindImageLayout({"x/y.png"}, kRig, CameraNaming(), "");
  EXPECT_EQ(reading.layout, ImageLayout::kByFrame);
  EXPECT_EQ(reading.first_known, -1);
}

// Frames and cameras that are numbers: the folders of a few frames are cameras
// as well, but most images and cameras speak for one reading.
TEST(ImageLayout, NumbersOfWhichOneReadingExplainsMore) {
  std::vector<std::string> rig, by_frame, by_camera;
  for (int camera = 0; camera < 20; ++camera) {
    rig.push_back(std::to_string(camera));
    for (int frame = 0; frame < 10; ++frame) {
      const std::string frame_name = "00" + std::to_string(frame);
      by_frame.push_back(frame_name + "/" + rig.back() + ".png");
      by_camera.push_back(rig.back() + "/" + frame_name + ".png");
    }
  }
  std::sort(by_frame.begin(), by_frame.end());
  EXPECT_EQ(Layout(by_frame, rig), ImageLayout::kByFrame);
  // All 20 folders are cameras; only 10 names are.
  EXPECT_EQ(Layout(by_camera, rig), ImageLayout::kByCamera);
}

TEST(ImageLayout, AmbiguityIsAnErrorThatTheRegexDecides) {
  std::vector<std::string> rig, paths;
  for (const char* folder : {"1", "2", "3"}) {
    rig.push_back(folder);
    for (const char* name : {"1", "2", "3"}) {
      paths.push_back(std::string(folder) + "/" + name + ".png");
    }
  }
  ExpectInputError([&]() { Layout(paths, rig); },
                   {"images by frame (1/1.png: camera '1', frame '1')",
                    "images by camera (1/1.png",
                    "--MultiFrame.frame_name_regex '^([^/]+)/'",
                    "'([^/]+)\\.\\w+$' for the second"});
  EXPECT_EQ(Layout(paths, rig, "^([^/]+)/"), ImageLayout::kByFrame);
  EXPECT_EQ(Layout(paths, rig, "([^/]+)\\.\\w+$"), ImageLayout::kByCamera);
  ExpectInputError([&]() { Layout(paths, rig, "(png)"); },
                   {"frame_name_regex '(png)' agrees with no layout"});
  EXPECT_THROW(Layout(paths, rig, "no group"), UsageError);
  EXPECT_THROW(Layout(paths, rig, "(a"), UsageError);

  ExpectInputError(
      [&]() {
        Layout({"1_2.png", "2_1.png"}, {"1", "2"});
      },
      {"the camera first (1_2.png", "the frame first", "Decide with"});
  EXPECT_EQ(Layout({"1_2.png", "2_1.png"}, {"1", "2"}, "_([^_/]+)\\.\\w+$"),
            ImageLayout::kFlatCameraFirst);
}

TEST(ImageLayout, TwoRegexesDecideAlone) {
  EXPECT_EQ(
      Locate(
          {"day1/shot3/L-7.png", "day1/notes.png"}, "L-(\\d+)", "shot(\\d+)"),
      Located({{"day1/shot3/L-7.png", "3", "7"}}));
}

// The layouts without folders of frames name their images with paths.
TEST(ImageLayout, NamesOfAFrameAreFoundAgain) {
  using Names = std::vector<std::string>;
  const CameraNaming naming = CameraNaming().OfFrame("000");
  EXPECT_EQ(naming.Names({"cam_1/000.png", "cam_11/000.png"}),
            Names({"cam_1", "cam_11"}));
  EXPECT_EQ(naming.Names({"c1/c1_000.png", "c2/c2_000.png"}),
            Names({"c1", "c2"}));
  EXPECT_EQ(naming.Names({"cam_1_000.png", "000-cam_11.png"}),
            Names({"cam_1", "cam_11"}));
  EXPECT_EQ(naming.Names({"cam_1.png", "cam_11.png"}),
            Names({"cam_1", "cam_11"}));
}

}  // namespace
}  // namespace mfir
