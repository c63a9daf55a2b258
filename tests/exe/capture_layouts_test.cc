// The same capture by frame, by camera, in one folder, and as videos; and all
// of it by one command.

#include <filesystem>

#include <opencv2/imgcodecs.hpp>
#include <opencv2/videoio.hpp>

#include "colmap_ext/models/model_io.h"
#include "colmap_ext/simulation/simulator.h"
#include "tests/support/refiner_runner.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

const int kNumCameras = RenderedCapture().num_cameras;
const char* const kFrames[] = {"frame000000", "frame000001"};

std::string CameraName(int idx) { return "cam0" + std::to_string(idx); }

class CaptureLayoutsTest : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    capture_ = new TemporaryFolder;
    WriteSimulatedCapture(SimulateCapture(RenderedCapture()),
                          *capture_ / "capture");
  }
  static void TearDownTestSuite() { delete capture_; }

  static std::string ImagePath(const std::string& frame, int camera) {
    return *capture_ /
           ("capture/images/" + frame + "/" + CameraName(camera) + ".png");
  }

  // Copies the images to names that `name` makes of frame and camera.
  template <typename Function>
  void CopyImages(const Function& name) const {
    for (const char* frame : kFrames) {
      for (int camera = 0; camera < kNumCameras; ++camera) {
        const fs::path path = folder_ / ("images/" + name(frame, camera));
        fs::create_directories(path.parent_path());
        fs::copy(ImagePath(frame, camera), path);
      }
    }
  }

  // A lossless video per camera, with the frames at `first` and after it. The
  // others are black.
  void WriteVideo(int camera, int first) const {
    fs::create_directories(folder_ / "images");
    cv::VideoWriter video;
    for (int i = -first; i < 2; ++i) {
      cv::Mat image = cv::imread(ImagePath(kFrames[std::max(i, 0)], camera));
      if (i < 0) image.setTo(0);
      if (!video.isOpened()) {
        video.open(folder_ / ("images/" + CameraName(camera) + ".avi"),
                   cv::CAP_FFMPEG,
                   cv::VideoWriter::fourcc('F', 'F', 'V', '1'),
                   25.0,
                   image.size());
        ASSERT_TRUE(video.isOpened());
      }
      video.write(image);
    }
  }

  CommandResult Triangulate(const std::vector<std::string>& more = {}) const {
    std::vector<std::string> arguments = {
        "multi_frame_triangulator",
        "--image_path",
        folder_ / "images",
        "--extrinsics_path",
        *capture_ / "capture/rig",
        "--output_path",
        folder_ / "frames",
        "--SiftExtraction.max_num_features",
        "300",
        "--MultiFrameTriangulator.num_threads",
        "2"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return RunColmap(arguments, 300);
  }

  void ExpectFrame(const std::string& frame,
                   const std::string& first_name) const {
    host::Reconstruction model;
    ReadModel(folder_ / ("frames/" + frame + "/sparse/0"), true, &model);
    EXPECT_EQ(model.NumRegImages(), kNumCameras);
    EXPECT_GT(model.NumPoints3D(), 150);
    EXPECT_NE(model.FindImageWithName(first_name), nullptr) << first_name;
  }

  static TemporaryFolder* capture_;
  TemporaryFolder folder_;
};

TemporaryFolder* CaptureLayoutsTest::capture_ = nullptr;

TEST_F(CaptureLayoutsTest, ByCameraWithMasksAndRefinedWithDenseFeatures) {
  CopyImages([](const std::string& frame, int camera) {
    return CameraName(camera) + "/" + frame + ".png";
  });
  fs::create_directories(folder_ / "masks");
  fs::copy(ImagePath(kFrames[0], 0), folder_ / "masks/cam00.png");
  const CommandResult result = Triangulate({"--mask_path", folder_ / "masks"});
  ASSERT_EQ(result.exit_code, 0) << result.error;
  EXPECT_NE(result.output.find("images by camera: cam00/frame000000.png"),
            std::string::npos)
      << result.output;
  EXPECT_NE(result.output.find("2 of 20 images have a mask"), std::string::npos)
      << result.output;
  ExpectFrame(kFrames[1], "cam03/frame000001.png");

  const CommandResult refined =
      RunColmap({"multi_frame_intrinsics_refiner",
                 "--input_path",
                 folder_ / "frames",
                 "--extrinsics_path",
                 *capture_ / "capture/rig",
                 "--image_path",
                 folder_ / "images",
                 "--output_path",
                 folder_ / "out",
                 "--MultiFrame.dense_features",
                 "sift",
                 "--MultiFrame.retriangulation_rounds",
                 "0"},
                300);
  ASSERT_EQ(refined.exit_code, 0) << refined.error;
  EXPECT_EQ(refined.output.find("no dense features"), std::string::npos)
      << refined.output;
}

TEST_F(CaptureLayoutsTest, InOneFolder) {
  CopyImages([](const std::string& frame, int camera) {
    return frame + "_" + CameraName(camera) + ".png";
  });
  const CommandResult result = Triangulate();
  ASSERT_EQ(result.exit_code, 0) << result.error;
  EXPECT_NE(result.output.find("the frame first: frame000000_cam00.png"),
            std::string::npos)
      << result.output;
  ExpectFrame(kFrames[0], "frame000000_cam03.png");
}

TEST_F(CaptureLayoutsTest, VideosByOneCommand) {
  for (int camera = 0; camera < kNumCameras; ++camera) {
    WriteVideo(camera, camera == 3 ? 2 : 0);
  }
  WriteFile(folder_ / "offsets.txt", "# starts later\ncam03 2\n");
  const CommandResult result =
      RunColmap({"multi_frame_automatic_refiner",
                 "--workspace_path",
                 folder_ / "w",
                 "--image_path",
                 folder_ / "images",
                 "--extrinsics_path",
                 *capture_ / "capture/rig",
                 "--SiftExtraction.max_num_features=300",
                 "--MultiFrame.video_offset_list_path",
                 folder_ / "offsets.txt",
                 "--MultiFrame.retriangulation_rounds",
                 "0",
                 "--MultiFrame.output_types",
                 "metashape"},
                300);
  ASSERT_EQ(result.exit_code, 0) << result.error;
  EXPECT_NE(result.output.find("2 frames to decode"), std::string::npos);
  EXPECT_NE(result.output.find("What has changed"), std::string::npos);
  EXPECT_TRUE(fs::exists(folder_ / "w/refined/metashape.xml"));
  for (const int camera : {0, 3}) {
    const std::string name = CameraName(camera) + ".png";
    const cv::Mat decoded =
        cv::imread(folder_ / ("w/frames/000001/images/" + name));
    const cv::Mat expected = cv::imread(ImagePath(kFrames[1], camera));
    EXPECT_EQ(cv::norm(decoded, expected, cv::NORM_INF), 0.0) << name;
  }
}

// Of three frames the middle one; those of an earlier run are not used.
TEST_F(CaptureLayoutsTest, MaxNumFrames) {
  CopyImages([](const std::string& frame, int camera) {
    return frame + "/" + CameraName(camera) + ".png";
  });
  fs::create_directories(folder_ / "images/frame000002");
  fs::create_directories(folder_ / "w/frames/frame000000/sparse/0");
  const CommandResult result = RunColmap({"multi_frame_automatic_refiner",
                                          "--workspace_path",
                                          folder_ / "w",
                                          "--image_path",
                                          folder_ / "images",
                                          "--extrinsics_path",
                                          *capture_ / "capture/rig",
                                          "--SiftExtraction.max_num_features",
                                          "300",
                                          "--MultiFrame.max_num_frames",
                                          "1"},
                                         300);
  ASSERT_EQ(result.exit_code, 0) << result.error;
  EXPECT_NE(result.output.find("1 of 3 frames are taken (max_num_frames): "
                               "frame000001\n"),
            std::string::npos)
      << result.output;
  EXPECT_EQ(ReadFile(folder_ / "w/frames/frame_list.txt"), "frame000001\n");
  EXPECT_TRUE(fs::exists(folder_ / "w/refined/frames/frame000001"));
  EXPECT_FALSE(fs::exists(folder_ / "w/refined/frames/frame000000"));
}

TEST_F(CaptureLayoutsTest, BadVideosAndOptionsHaveTheirExitCodes) {
  WriteFile(folder_ / "images/cam00.mp4", "no video");
  const auto expect =
      [](const CommandResult& result, int exit_code, const std::string& part) {
        EXPECT_EQ(result.exit_code, exit_code) << result.error;
        EXPECT_NE(result.error.find(part), std::string::npos) << result.error;
      };
  expect(Triangulate(), 2, "cam00.mp4: the video cannot be opened");
  WriteFile(folder_ / "list.txt", "x\n");
  expect(Triangulate({"--frame_list_path", folder_ / "list.txt"}),
         2,
         "list.txt:1: 'x' is not the number of a frame");
  expect(Triangulate(
             {"--MultiFrame.video_offset_list_path", folder_ / "list.txt"}),
         2,
         "list.txt:1: 'x' is not a camera and its offset");
  fs::rename(folder_ / "images/cam00.mp4", folder_ / "images/other.mp4");
  expect(Triangulate(), 2, "has no video of a camera of RIG");
  const auto automatic = [](const std::vector<std::string>& more) {
    std::vector<std::string> arguments = {"multi_frame_automatic_refiner"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return RunColmap(arguments);
  };
  expect(automatic({}), 1, "--workspace_path is missing");
  expect(automatic({"--workspace_path", "w", "--input_path", "x"}),
         1,
         "--input_path is not for this command");
  expect(automatic({"--workspace_path", "w", "--no_such", "x"}),
         1,
         "--no_such is an option of neither");
  // What all commands of COLMAP take goes on to the steps.
  expect(automatic({"--workspace_path", folder_ / "w", "--log_level", "1"}),
         1,
         "--image_path is required");
  EXPECT_EQ(automatic({"--help"}).exit_code, 0);
}

}  // namespace
}  // namespace mfir
