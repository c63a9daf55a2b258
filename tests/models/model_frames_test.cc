#include "colmap_ext/models/model_frames.h"

#include <filesystem>

#include "colmap_ext/models/model_io.h"
#include "tests/support/frames_file.h"
#include "tests/support/test_files.h"

namespace mfir {
namespace {

using Frames = std::vector<std::vector<host::image_t>>;

// Images 1 to 4 and no points.
class ModelFramesTest : public testing::Test {
 protected:
  void SetUp() override {
    host::Reconstruction model;
    host::AddCameraWithTrivialRig(
        host::MakeCamera(1, /*model_id=*/1, 640, 480, {500, 500, 320, 240}),
        &model);
    for (host::image_t id = 1; id <= 4; ++id) {
      host::Image image;
      image.SetImageId(id);
      image.SetCameraId(1);
      image.SetName(std::to_string(id) + ".png");
      host::AddImageWithTrivialFrame(
          image,
          {Eigen::Quaterniond::Identity(), Eigen::Vector3d::Zero()},
          &model);
    }
    for (const std::string folder : {"binary", "text"}) {
      std::filesystem::create_directory(folder_ / folder);
    }
    model.WriteBinary(folder_ / "binary");
    model.WriteText(folder_ / "text");
    // COLMAP 4 writes the trivial ones.
    std::filesystem::remove(folder_ / "binary/frames.bin");
    std::filesystem::remove(folder_ / "text/frames.txt");
  }

  Frames Read(const std::string& name) const {
    host::Reconstruction model;
    ReadModel(folder_ / name, false, &model);
    return ReadModelFrames(folder_ / name, model);
  }

  TemporaryFolder folder_;
};

TEST_F(ModelFramesTest, NoFile) {
  EXPECT_EQ(Read("binary"), Frames());
  EXPECT_EQ(Read("text"), Frames());
}

TEST_F(ModelFramesTest, Binary) {
  // Image 9 is not registered.
  WriteFile(folder_ / "binary/frames.bin", FramesFile({{3, 1}, {2, 9, 4}}));
  EXPECT_EQ(Read("binary"), Frames({{3, 1}, {2, 4}}));
}

TEST_F(ModelFramesTest, Text) {
  WriteFile(folder_ / "text/frames.txt",
            WithInvisibles("# comment\n"
                           "7 1 1 0 0 0 0 0 0 2 CAMERA 1 2 CAMERA 2 4\n"
                           "\n"
                           "5 1 1 0 0 0 0 0 0 3 CAMERA 1 3 IMU 2 4 CAMERA 2 1\n"
                           "8 1 1 0 0 0 0 0 0 1 CAMERA 1 9\n"));
  EXPECT_EQ(Read("text"), Frames({{3, 1}, {2, 4}}));
}

TEST_F(ModelFramesTest, EveryTruncationIsAnError) {
  const std::string bytes = FramesFile({{3, 1}, {2, 4}});
  for (size_t size = 0; size < bytes.size(); ++size) {
    WriteFile(folder_ / "binary/frames.bin", bytes.substr(0, size));
    ExpectInputError([&] { Read("binary"); }, {"frames.bin"});
  }
  WriteFile(folder_ / "binary/frames.bin", bytes + "x");
  ExpectInputError([&] { Read("binary"); }, {"1 bytes too many"});
}

TEST_F(ModelFramesTest, ContradictingFrames) {
  const auto expect_error = [this](const Frames& frames,
                                   const std::string& part) {
    WriteFile(folder_ / "binary/frames.bin", FramesFile(frames));
    ExpectInputError([&] { Read("binary"); }, {"frames.bin", part});
  };
  expect_error({{1, 2}, {3, 4, 1}}, "image 1 is of two frames");
  expect_error({{1, 2}, {3}}, "image 4 is of no frame");
  std::string bytes = FramesFile({{1, 2}, {3, 4}});
  const size_t second_id = 8 + 4 + 4 + 7 * 8 + 4 + 2 * 16;
  ASSERT_EQ(bytes[second_id], 2);
  bytes[second_id] = 1;
  WriteFile(folder_ / "binary/frames.bin", bytes);
  ExpectInputError([&] { Read("binary"); }, {"frame id 1 occurs twice"});
}

TEST_F(ModelFramesTest, BadLines) {
  const auto expect_error = [this](const std::string& line,
                                   const std::string& part) {
    WriteFile(folder_ / "text/frames.txt",
              "9 1 1 0 0 0 0 0 0 2 CAMERA 1 1 CAMERA 1 2\n" + line);
    ExpectInputError([&] { Read("text"); }, {"frames.txt:2: ", part});
  };
  expect_error("x", "FRAME_ID: 'x'");
  expect_error("9 1 1 0 0 0 0 0 0 1 CAMERA 1 3", "FRAME_ID 9 occurs");
  expect_error("3 1 1 0 0 0 nan 0 0 1 CAMERA 1 3", "TX is not finite");
  expect_error("3 1 1 0 0 0 0 0 0 2 CAMERA 1 3", "SENSOR_TYPE is missing");
  expect_error("3 1 1 0 0 0 0 0 0 1 CAMERA 1 3 4", "unexpected '4'");
}

}  // namespace
}  // namespace mfir
