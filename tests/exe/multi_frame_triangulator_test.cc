// The command from images to frames, on a small rendered capture.

#include <filesystem>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "colmap_ext/host/database.h"
#include "colmap_ext/host/image_file.h"
#include "colmap_ext/host/util.h"
#include "colmap_ext/io/sqlite_file.h"
#include "colmap_ext/models/model_io.h"
#include "colmap_ext/simulation/simulator.h"
#include "tests/support/refiner_runner.h"
#include "tests/support/test_files.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

const size_t kNumRenderedCameras = RenderedCapture().num_cameras;
const char* const kRendered0 = "frame000000";
const char* const kRendered1 = "frame000001";

nlohmann::json ReadJson(const std::string& path) {
  return nlohmann::json::parse(ReadFile(path));
}

class TriangulatorTest : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    capture_ = new TemporaryFolder;
    WriteSimulatedCapture(SimulateCapture(RenderedCapture()),
                          *capture_ / "capture");
    const CommandResult result = Run({{"output_path", *capture_ / "frames"}});
    ASSERT_EQ(result.exit_code, 0) << result.error;
  }
  static void TearDownTestSuite() { delete capture_; }

  static std::string Input(const std::string& name) {
    return *capture_ / ("capture/" + name);
  }

  // An option with the value "-" is left out.
  static CommandResult Run(const CommandOptions& options) {
    CommandOptions all = {{"image_path", Input("images")},
                          {"extrinsics_path", Input("rig")},
                          {"SiftExtraction.max_num_features", "500"},
                          {"MultiFrameTriangulator.num_threads", "2"}};
    for (const auto& [name, value] : options) all[name] = value;
    std::vector<std::string> arguments = {"multi_frame_triangulator"};
    for (const auto& [name, value] : all) {
      if (value == "-") continue;
      arguments.push_back("--" + name);
      arguments.push_back(value);
    }
    return RunColmap(arguments, 300);
  }

  // The frames of the first run, to go on from.
  void CopyFrames() const {
    fs::copy(*capture_ / "frames", Path("frames"), fs::copy_options::recursive);
  }

  // Images of frame 0 only.
  void CopyImages() const {
    fs::create_directories(Path("images"));
    fs::copy(Input("images/" + std::string(kRendered0)),
             Path("images/" + std::string(kRendered0)),
             fs::copy_options::recursive);
  }

  std::string Path(const std::string& name) const { return folder_ / name; }
  std::string InFrame(const std::string& frame, const std::string& name) const {
    return Path("frames/" + frame + "/" + name);
  }

  static TemporaryFolder* capture_;
  TemporaryFolder folder_;
};

TemporaryFolder* TriangulatorTest::capture_ = nullptr;

size_t NumPoints(const std::string& model_path) {
  host::Reconstruction model;
  ReadModel(model_path, /*require_points=*/true, &model);
  return model.NumPoints3D();
}

TEST_F(TriangulatorTest, FramesHaveAllCamerasWithTheGivenCalibration) {
  CopyFrames();
  host::Reconstruction rig;
  ReadModel(Input("rig"), /*require_points=*/false, &rig);
  for (const char* frame : {kRendered0, kRendered1}) {
    host::Reconstruction model;
    ReadModel(InFrame(frame, "sparse/0"), /*require_points=*/true, &model);
    EXPECT_EQ(model.NumRegImages(), kNumRenderedCameras);
    EXPECT_GT(model.NumPoints3D(), 300);
    EXPECT_GT(model.ComputeMeanTrackLength(), 2.5);
    for (const auto& [image_id, image] : rig.Images()) {
      const host::Image* found = model.FindImageWithName(image.Name());
      ASSERT_NE(found, nullptr) << image.Name();
      EXPECT_EQ(host::CamFromWorld(*found).rotation.coeffs(),
                host::CamFromWorld(image).rotation.coeffs());
      EXPECT_EQ(host::CamFromWorld(*found).translation,
                host::CamFromWorld(image).translation);
      EXPECT_EQ(host::Params(model.Camera(found->CameraId())),
                host::Params(rig.Camera(image.CameraId())));
      EXPECT_EQ(model.Camera(found->CameraId()).ModelName(), "OPENCV");
    }
    const auto record = ReadJson(InFrame(frame, "triangulation.json"));
    EXPECT_EQ(record["num_points"], model.NumPoints3D());
    EXPECT_GT(record["median_tolerance_px"], 1.0);
    EXPECT_LE(record["median_tolerance_px"], 0.02 * 280);
    // COLMAP itself reads the verified matches.
    const auto database = host::OpenDatabase(InFrame(frame, "database.db"));
    EXPECT_EQ(database->NumVerifiedImagePairs(), record["num_pairs"]);
    EXPECT_EQ(database->NumInlierMatches(), record["num_inlier_matches"]);
    EXPECT_FALSE(fs::exists(InFrame(frame, ".unfinished")));
  }
}

TEST_F(TriangulatorTest, IntrinsicsOfDistortedCamerasComeOutOfImages) {
  CopyFrames();
  const CommandResult result = RunColmap({"multi_frame_intrinsics_refiner",
                                          "--input_path",
                                          Path("frames"),
                                          "--extrinsics_path",
                                          Input("rig"),
                                          "--ground_truth_path",
                                          Input("ground_truth"),
                                          "--output_path",
                                          Path("out"),
                                          "--MultiFrame.num_threads",
                                          "1",
                                          // See retriangulation_test.
                                          "--MultiFrame.retriangulation_rounds",
                                          "0"},
                                         300);
  ASSERT_EQ(result.exit_code, 0) << result.error;
  ASSERT_EQ(RunColmap({"multi_frame_evaluator",
                       "--input_path",
                       Input("rig"),
                       "--ground_truth_path",
                       Input("ground_truth"),
                       "--output_path",
                       Path("start.json")})
                .exit_code,
            0);
  const auto start = ReadJson(Path("start.json"));
  const auto refined = ReadJson(Path("out/summary.json"))["evaluation"];
  const auto expect_less = [](const nlohmann::json& after,
                              const nlohmann::json& before,
                              double factor) {
    EXPECT_LT(after["mean"].get<double>(),
              factor * before["mean"].get<double>());
  };
  // The common focal scale is weak in so small a capture, and principal points
  // trade with tangential distortion.
  expect_less(refined["rest"]["focal_rel"], start["rest"]["focal_rel"], 0.3);
  expect_less(refined["rest"]["pp_abs"], start["rest"]["pp_abs"], 0.7);
}

TEST_F(TriangulatorTest, KeypointsAreRefinedOnTheImages) {
  const std::string true_rig = Input("ground_truth");
  ASSERT_EQ(Run({{"intrinsics_path", true_rig}, {"output_path", Path("plain")}})
                .exit_code,
            0);
  const CommandResult result =
      Run({{"intrinsics_path", true_rig},
           {"output_path", Path("refined")},
           {"MultiFrameTriangulator.refine_keypoints", "1"},
           {"MultiFrameTriangulator.complete_tracks", "1"}});
  ASSERT_EQ(result.exit_code, 0) << result.error;
  EXPECT_NE(result.output.find("tracks refined"), std::string::npos);
  for (const std::string frame : {kRendered0, kRendered1}) {
    host::Reconstruction plain;
    host::Reconstruction refined;
    const std::string model = "/" + frame + "/sparse/0";
    ReadModel(Path("plain" + model), /*require_points=*/true, &plain);
    ReadModel(Path("refined" + model), /*require_points=*/true, &refined);
    EXPECT_LT(refined.ComputeMeanReprojectionError(),
              0.7 * plain.ComputeMeanReprojectionError());
    EXPECT_GT(refined.ComputeMeanTrackLength(),
              1.2 * plain.ComputeMeanTrackLength());
    const nlohmann::json record =
        ReadJson(Path("refined/" + frame + "/triangulation.json"));
    EXPECT_EQ(record["num_points"], refined.NumPoints3D());
    EXPECT_EQ(record["num_observations"], refined.ComputeNumObservations());
  }
}

TEST_F(TriangulatorTest, GivenDatabasesAreUsedAndNotChanged) {
  CopyFrames();
  // One frame with two-view geometries, one with matches only.
  {
    const auto database =
        host::OpenDatabase(InFrame(kRendered1, "database.db"));
    database->ClearTwoViewGeometries();
  }
  std::map<std::string, std::string> bytes;
  std::map<std::string, size_t> num_points;
  for (const char* frame : {kRendered0, kRendered1}) {
    bytes[frame] = ReadFile(InFrame(frame, "database.db"));
    num_points[frame] = NumPoints(InFrame(frame, "sparse/0"));
    fs::remove_all(InFrame(frame, "sparse"));
    fs::remove(InFrame(frame, "triangulation.json"));
  }
  // No overwriting of what this command has not made.
  const CommandResult result = Run({{"output_path", Path("frames")},
                                    {"SiftExtraction.max_num_features", "100"},
                                    {"MultiFrameTriangulator.overwrite", "1"}});
  ASSERT_EQ(result.exit_code, 0) << result.error;
  for (const char* frame : {kRendered0, kRendered1}) {
    EXPECT_TRUE(ReadFile(InFrame(frame, "database.db")) == bytes[frame]);
    EXPECT_FALSE(fs::exists(InFrame(frame, "database.db-wal")));
    EXPECT_EQ(ReadJson(InFrame(frame, "triangulation.json"))["database"],
              "given");
  }
  // Verification of the stored matches gives what it gave the first time.
  EXPECT_EQ(NumPoints(InFrame(kRendered1, "sparse/0")), num_points[kRendered1]);
  // No tolerance is known for geometries that come verified.
  EXPECT_GT(NumPoints(InFrame(kRendered0, "sparse/0")),
            0.7 * num_points[kRendered0]);
}

TEST_F(TriangulatorTest, FinishedFramesAreKeptAndUnfinishedOnesRedone) {
  CopyFrames();
  const std::string database = ReadFile(InFrame(kRendered0, "database.db"));
  const std::string points =
      ReadFile(InFrame(kRendered0, "sparse/0/points3D.bin"));
  // As after a kill: half a model, an empty record, a rest of the unfinished
  // folder.
  WriteFile(InFrame(kRendered0, "sparse/0/points3D.bin"), "half");
  WriteFile(InFrame(kRendered0, ".unfinished/database.db"), "half");
  WriteFile(InFrame(kRendered0, "triangulation.json"), "{\"inputs\": 5}");
  const auto time =
      fs::last_write_time(InFrame(kRendered1, "sparse/0/images.bin"));
  const CommandResult result = Run({{"output_path", Path("frames")}});
  ASSERT_EQ(result.exit_code, 0) << result.error;
  EXPECT_NE(result.output.find("finished before"), std::string::npos);
  EXPECT_EQ(fs::last_write_time(InFrame(kRendered1, "sparse/0/images.bin")),
            time);
  EXPECT_GT(NumPoints(InFrame(kRendered0, "sparse/0")), 300);
  EXPECT_TRUE(ReadFile(InFrame(kRendered0, "database.db")) == database);
  EXPECT_FALSE(fs::exists(InFrame(kRendered0, ".unfinished")));

  // Other options: the model is made anew, from the same database.
  const CommandResult other = Run({{"output_path", Path("frames")},
                                   {"Mapper.tri_ignore_two_view_tracks", "1"}});
  ASSERT_EQ(other.exit_code, 0) << other.error;
  EXPECT_EQ(other.output.find("finished before"), std::string::npos);
  EXPECT_TRUE(ReadFile(InFrame(kRendered0, "database.db")) == database);
  EXPECT_NE(ReadFile(InFrame(kRendered0, "sparse/0/points3D.bin")), points);
}

TEST_F(TriangulatorTest, ModelsOfOtherProgramsAreNotReplaced) {
  CopyFrames();
  fs::remove(InFrame(kRendered0, "triangulation.json"));
  const std::string points =
      ReadFile(InFrame(kRendered0, "sparse/0/points3D.bin"));
  const CommandResult result = Run({{"output_path", Path("frames")},
                                    {"MultiFrameTriangulator.overwrite", "1"}});
  EXPECT_EQ(result.exit_code, 0);
  EXPECT_NE(result.error.find("frame000000/sparse/0 is there, but not from "
                              "this command"),
            std::string::npos)
      << result.error;
  EXPECT_TRUE(ReadFile(InFrame(kRendered0, "sparse/0/points3D.bin")) == points);
}

// COLMAP aborts at these.
TEST_F(TriangulatorTest, DatabasesThatCannotBeRead) {
  for (const auto& [sql, part] : std::map<std::string, std::string>{
           {"DELETE FROM keypoints", "an image has no keypoints"},
           {"UPDATE cameras SET model = 99", "unknown model"},
           {"UPDATE descriptors SET data = substr(data, 1, 100)",
            "descriptors do not have the size"},
           {"UPDATE descriptors SET data = NULL",
            "descriptors do not have the size"},
           {"UPDATE descriptors SET rows = -1",
            "descriptors do not have the size"},
           {"UPDATE cameras SET params = x'00'", "parameters"}}) {
    SCOPED_TRACE(sql);
    CopyFrames();
    for (const char* frame : {kRendered0, kRendered1}) {
      fs::remove_all(InFrame(frame, "sparse"));
      fs::remove(InFrame(frame, "triangulation.json"));
      SqliteFile(InFrame(frame, "database.db"), SQLITE_OPEN_READWRITE)
          .Execute(sql);
    }
    const CommandResult result = Run({{"output_path", Path("frames")}});
    EXPECT_EQ(result.exit_code, 2);
    EXPECT_NE(result.error.find(part), std::string::npos) << result.error;
    fs::remove_all(Path("frames"));
  }
}

TEST_F(TriangulatorTest, BadFramesDoNotStopTheOthers) {
  CopyImages();
  fs::create_directories(Path("images/empty"));
  WriteFile(Path("images/broken/cam00.png"), "no image");
  WriteFile(Path("images/broken/cam01.png"), "no image");
  fs::copy(Path("images/frame000000"), Path("images/twice"));
  fs::copy(Path("images/frame000000/cam03.png"),
           Path("images/twice/cam03.jpg"));
  fs::remove(Path("images/frame000000/cam09.png"));
  WriteFile(Path("images/frame000000/cam08.png"), "no image");
  WriteFile(Path("images/frame000000/notes.txt"), "no image");
  CopyFrames();
  fs::remove_all(Path("frames/frame000000"));
  fs::create_directories(Path("images/damaged"));
  WriteFile(InFrame("damaged", "database.db"), "SQLite format 3, or not");

  const CommandResult result =
      Run({{"output_path", Path("frames")}, {"image_path", Path("images")}});
  EXPECT_EQ(result.exit_code, 0) << result.error;
  for (const char* part :
       {"'empty' is left out: 0 readable images",
        "'broken' is left out: 0 readable images",
        "'twice' is left out: the images 'cam03.jpg' and 'cam03.png'",
        "database.db is no usable COLMAP database"}) {
    EXPECT_NE(result.error.find(part), std::string::npos) << part << "\n"
                                                          << result.error;
  }
  EXPECT_NE(result.output.find("cam08.png: cannot read the image"),
            std::string::npos);
  EXPECT_EQ(ReadJson(InFrame(kRendered0, "triangulation.json"))["num_images"],
            kNumRenderedCameras - 2);
  EXPECT_FALSE(fs::exists(Path("frames/empty")));
  EXPECT_EQ(ReadFile(InFrame("damaged", "database.db")),
            "SQLite format 3, or not");

  WriteFile(Path("list.txt"), "empty\nbroken\n");
  const CommandResult none = Run({{"output_path", Path("frames")},
                                  {"image_path", Path("images")},
                                  {"frame_list_path", Path("list.txt")}});
  EXPECT_EQ(none.exit_code, 2);
  EXPECT_NE(none.error.find("No frame could be triangulated"),
            std::string::npos);
}

TEST_F(TriangulatorTest, MasksAndOptionsOfIniFilesReachTheExtraction) {
  CopyImages();
  const host::Bitmap black = host::MakeBitmap(280, 280, /*as_rgb=*/false);
  fs::create_directories(Path("masks/frame000000"));
  ASSERT_TRUE(black.Write(Path("masks/frame000000/cam00.png.png")));
  ASSERT_TRUE(black.Write(Path("masks/cam01.png.png")));
  WriteFile(Path("project.ini"),
            "mask_path=" + Path("masks") +
                "\ndatabase_path=somewhere.db\n[ImageReader]\nsingle_camera=0\n"
                "[SiftExtraction]\nmax_num_features=60\n"
                "[SiftMatching]\nconfidence=0.9\n"
                "[Mapper]\nmultiple_models=0\ntri_min_angle=25\n"
                "[MultiFrameTriangulator]\nmax_view_angle=50\n");
  const CommandResult result = Run({{"output_path", Path("frames")},
                                    {"image_path", Path("images")},
                                    {"project_path", Path("project.ini")},
                                    {"SiftExtraction.max_num_features", "-"}});
  ASSERT_EQ(result.exit_code, 0) << result.error;
  const auto database = host::OpenDatabase(InFrame(kRendered0, "database.db"));
  EXPECT_EQ(database->NumKeypointsForImage(1), 0);
  EXPECT_EQ(database->NumKeypointsForImage(2), 0);
  EXPECT_GT(database->NumKeypointsForImage(3), 30);
  EXPECT_LT(database->NumKeypointsForImage(3), 300);
  host::Reconstruction model;
  ReadModel(InFrame(kRendered0, "sparse/0"), /*require_points=*/true, &model);
  EXPECT_EQ(model.NumRegImages(), kNumRenderedCameras);
  for (const auto& [id, point] : model.Points3D()) {
    double max_angle = 0.0;
    for (const auto& a : host::TrackOf(point).Elements()) {
      for (const auto& b : host::TrackOf(point).Elements()) {
        const Eigen::Vector3d ray1 =
            model.Image(a.image_id).ProjectionCenter() - host::Xyz(point);
        const Eigen::Vector3d ray2 =
            model.Image(b.image_id).ProjectionCenter() - host::Xyz(point);
        max_angle = std::max(
            max_angle,
            std::acos(std::min(1.0, ray1.normalized().dot(ray2.normalized()))));
      }
    }
    // Points move a little after they are created.
    EXPECT_GT(host::RadToDeg(max_angle), 24.0);
  }
}

TEST_F(TriangulatorTest, FocalLengthFactorReplacesTheIntrinsics) {
  CopyImages();
  // About the true focal length, in the stead of the lens model of RIG.
  const host::Camera rig_camera = [&] {
    host::Reconstruction rig;
    ReadModel(Input("rig"), /*require_points=*/false, &rig);
    return rig.Camera(1);
  }();
  const double factor = rig_camera.FocalLengthX() / 280.0;
  const CommandResult result = Run(
      {{"output_path", Path("frames")},
       {"image_path", Path("images")},
       {"ImageReader.camera_model", "SIMPLE_RADIAL"},
       {"MultiFrameTriangulator.focal_length_factor", std::to_string(factor)}});
  ASSERT_EQ(result.exit_code, 0) << result.error;
  host::Reconstruction model;
  ReadModel(InFrame(kRendered0, "sparse/0"), /*require_points=*/true, &model);
  for (const auto& [id, camera] : model.Cameras()) {
    EXPECT_EQ(camera.ModelName(), "SIMPLE_RADIAL");
    EXPECT_NEAR(camera.FocalLength(), rig_camera.FocalLengthX(), 1e-3);
    EXPECT_EQ(camera.PrincipalPointX(), 140.0);
  }
}

TEST_F(TriangulatorTest, BadInputsHaveTheirExitCodes) {
  const auto run = [&](CommandOptions options) {
    options.emplace("output_path", Path("frames"));
    return Run(options);
  };
  EXPECT_EQ(run({{"image_path", "-"}}).exit_code, 1);
  EXPECT_EQ(run({{"Mapper.tri_no_such", "1"}}).exit_code, 1);
  EXPECT_EQ(run({{"SiftExtraction.peak_threshold", "-1"}}).exit_code, 1);
  EXPECT_EQ(run({{"Mapper.tri_min_angle", "0"}}).exit_code, 1);
  EXPECT_EQ(run({{"Mapper.tri_create_max_angle_error", "nan"}}).exit_code, 1);
  EXPECT_EQ(run({{"MultiFrameTriangulator.max_view_angle", "0"}}).exit_code, 1);
  EXPECT_EQ(run({{"MultiFrameTriangulator.num_threads", "0"}}).exit_code, 1);
  EXPECT_EQ(run({{"ImageReader.camera_model", "NONE"}}).exit_code, 1);
  EXPECT_EQ(run({{"SiftExtraction.first_octave", "-5"}}).exit_code, 1);
  EXPECT_EQ(run({{"extrinsics_format", "none"}}).exit_code, 1);
  EXPECT_EQ(run({{"intrinsics_pixel_offset", "inf"}}).exit_code, 1);
  EXPECT_EQ(run({{"image_path", Path("none")}}).exit_code, 2);
  EXPECT_EQ(run({{"extrinsics_path", Path("none")}}).exit_code, 2);
  EXPECT_EQ(run({{"intrinsics_path", Path("none")}}).exit_code, 2);
  EXPECT_EQ(run({{"mask_path", Path("none")}}).exit_code, 2);
  EXPECT_EQ(run({{"frame_list_path", Path("none")}}).exit_code, 2);
  EXPECT_EQ(run({{"ImageReader.camera_mask_path", Path("none")}}).exit_code, 2);
  // Names that do not belong to cameras of the rig.
  const CommandResult names =
      run({{"MultiFrame.camera_name_regex", "frame(\\d+)"}});
  EXPECT_EQ(names.exit_code, 2) << names.error;
  WriteFile(Path("file"), "");
  EXPECT_EQ(run({{"output_path", Path("file")}}).exit_code, 4);
  EXPECT_FALSE(fs::exists(Path("frames/frame000000")));
}

TEST_F(TriangulatorTest, ImagesOfAnotherSizeAreAnError) {
  CopyImages();
  host::Bitmap bitmap = host::MakeBitmap(140, 140, /*as_rgb=*/false);
  bitmap.Fill(host::BitmapColor(80));
  ASSERT_TRUE(bitmap.Write(Path("images/frame000000/cam02.png")));
  const CommandResult result =
      Run({{"output_path", Path("frames")}, {"image_path", Path("images")}});
  EXPECT_EQ(result.exit_code, 2);
  EXPECT_NE(result.error.find("cam02.png has 140 x 140 pixels"),
            std::string::npos)
      << result.error;
}

TEST_F(TriangulatorTest, MasksOfAnotherSizeAreAnError) {
  host::Bitmap mask = host::MakeBitmap(14, 14, /*as_rgb=*/false);
  mask.Fill(host::BitmapColor(255));
  fs::create_directories(Path("masks"));
  ASSERT_TRUE(mask.Write(Path("masks/cam02.png.png")));
  for (const auto& [option, value] : CommandOptions{
           {"mask_path", Path("masks")},
           {"ImageReader.camera_mask_path", Path("masks/cam02.png.png")}}) {
    const CommandResult result =
        Run({{"output_path", Path("frames")}, {option, value}});
    EXPECT_EQ(result.exit_code, 2);
    EXPECT_NE(result.error.find("cam02.png.png has 14 x 14 pixels"),
              std::string::npos)
        << result.error;
  }
}

}  // namespace
}  // namespace mfir
