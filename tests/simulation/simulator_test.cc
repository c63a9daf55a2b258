#include "colmap_ext/simulation/simulator.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>

#include "colmap_ext/exe/command.h"
#include "colmap_ext/host/image_file.h"
#include "colmap_ext/io/work_folder.h"
#include "colmap_ext/models/camera_models.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

SimulatorOptions SmallOptions() {
  SimulatorOptions options;
  options.num_cameras = 6;
  options.num_frames = 2;
  options.num_points = 80;
  options.azimuth = 50.0;
  options.image_width = 96;
  options.image_height = 128;
  options.max_outlier = 12.0;
  options.principal_point_sigma = 1.0;
  options.initial_principal_point_sigma = 1.0;
  options.quiet = true;
  return options;
}

class SimulatorTest : public ::testing::Test {
 protected:
  void SetUp() override {
    const auto* info = ::testing::UnitTest::GetInstance()->current_test_info();
    folder_ = fs::temp_directory_path() /
              ("simulator_test_" + std::to_string(getpid()) + info->name());
    fs::create_directories(folder_);
  }
  void TearDown() override { fs::remove_all(folder_); }

  // Simulates and writes; contents of all files by relative path.
  std::map<std::string, std::string> Files(const SimulatorOptions& options,
                                           const std::string& name) {
    const fs::path path = folder_ / name;
    WriteSimulatedCapture(SimulateCapture(options), path.string());
    std::map<std::string, std::string> files;
    for (const auto& entry : fs::recursive_directory_iterator(path)) {
      if (entry.is_regular_file()) {
        std::ifstream file(entry.path(), std::ios::binary);
        files[fs::relative(entry.path(), path).string()] =
            std::string(std::istreambuf_iterator<char>(file), {});
      }
    }
    return files;
  }

  fs::path folder_;
};

TEST_F(SimulatorTest, SameSeedGivesSameBytesForAnyNumberOfThreads) {
  SimulatorOptions options = SmallOptions();
  options.missing_share = 0.1;
  options.num_threads = 1;
  const auto files = Files(options, "a");
  options.num_threads = 2;
  EXPECT_EQ(files, Files(options, "b"));
  options.seed = 1;
  const auto other_files = Files(options, "c");
  for (const std::string name : {"frames/frame000001/sparse/0/images.bin",
                                 "ground_truth/cameras.txt",
                                 "images/frame000000/cam00.png",
                                 "KRT",
                                 "rig/images.txt",
                                 "simulation.json"}) {
    ASSERT_EQ(files.count(name), 1) << name;
    ASSERT_EQ(other_files.count(name), 1) << name;
    EXPECT_NE(files.at(name), other_files.at(name)) << name;
  }
}

TEST_F(SimulatorTest, WrittenModelsAreWhatWasSimulated) {
  const SimulatedCapture capture = SimulateCapture(SmallOptions());
  const fs::path path = folder_ / "capture/";
  WriteSimulatedCapture(capture, path.string());
  EXPECT_FALSE(fs::exists(WorkFolder::Beside(folder_ / "capture")));
  host::Reconstruction truth;
  host::ReadReconstruction(
      (path / "ground_truth").string(), /*is_binary=*/false, &truth);
  ASSERT_EQ(truth.NumRegImages(), 6);
  for (size_t i = 0; i < 6; ++i) {
    EXPECT_EQ(host::Params(truth.Camera(i + 1)),
              capture.true_cameras[i].params);
    EXPECT_EQ(truth.Image(i + 1).Name(), capture.true_cameras[i].name + ".png");
  }
  host::Reconstruction frame;
  host::ReadReconstruction((path / "frames/frame000001/sparse/0").string(),
                           /*is_binary=*/true,
                           &frame);
  EXPECT_EQ(frame.NumPoints3D(), capture.frames[1].sfm_model.NumPoints3D());
  EXPECT_EQ(host::Xyz(frame.Point3D(1)),
            host::Xyz(capture.frames[1].sfm_model.Point3D(1)));
  host::Bitmap bitmap;
  ASSERT_TRUE(
      bitmap.Read((path / "images/frame000001/cam02.png").string(), false));
  EXPECT_EQ(host::RowMajorData(bitmap),
            RenderSimulatedImage(capture, 1, 2).pixels);
}

TEST_F(SimulatorTest, EveryCameraModelHasExactTruth) {
  for (const CameraModel* model : AllCameraModels()) {
    SimulatorOptions options = SmallOptions();
    options.camera_model = model->Name();
    options.num_frames = 1;
    options.distortion = 0.05;
    for (const double focal_length : {0.0, 90.0}) {
      options.focal_length = focal_length;
      options.distance = focal_length == 0.0 ? 1.0 : 0.3;
      options.num_points = focal_length == 0.0 ? 80 : 40;
      const SimulatedCapture capture = SimulateCapture(options);
      const host::Reconstruction& truth = capture.frames[0].true_model;
      double max_error = 0.0;
      for (const auto& [id, point] : truth.Points3D()) {
        for (const auto& element : host::TrackOf(point).Elements()) {
          const host::Image& image = truth.Image(element.image_id);
          const Eigen::Vector2d xy =
              host::ImgFromCam(truth.Camera(image.CameraId()),
                               host::CamFromWorld(image) * host::Xyz(point));
          max_error = std::max(
              max_error,
              (xy - host::Xy(image.Point2D(element.point2D_idx))).norm());
        }
      }
      EXPECT_LT(max_error, 1e-9) << model->Name();
      // All pixels lie in the part of the lens model that can be inverted.
      for (const RigCamera& camera : capture.true_cameras) {
        for (size_t y = 0; y <= camera.height; y += 8) {
          for (size_t x = 0; x <= camera.width; x += 8) {
            Eigen::Vector2d uv, xy;
            model->Unproject(camera.params.data(), x, y, uv.data());
            model->Project(camera.params.data(), uv.x(), uv.y(), xy.data());
            EXPECT_LT((xy - Eigen::Vector2d(x, y)).norm(), 1e-3)
                << model->Name();
          }
        }
      }
    }
  }
}

TEST_F(SimulatorTest, NoiseAndOutliersHaveTheirStatistics) {
  SimulatorOptions options = SmallOptions();
  options.image_width = 640;
  options.image_height = 800;
  options.num_frames = 1;
  options.num_points = 3000;
  options.noise = 0.7;
  options.outlier_share = 0.1;
  options.min_outlier = 6.0;
  const SimulatedCapture capture = SimulateCapture(options);
  const SimulatedFrame& frame = capture.frames[0];
  double sum2 = 0.0, sum = 0.0;
  size_t num_inliers = 0, num_outliers = 0, num_keypoints = 0;
  for (const auto& [id, image] : frame.sfm_model.Images()) {
    const host::Image& true_image = frame.true_model.Image(id);
    num_keypoints += image.NumPoints2D();
    for (size_t i = 0; i < image.NumPoints2D(); ++i) {
      if (!image.Point2D(i).HasPoint3D()) continue;
      const Eigen::Vector2d error =
          host::Xy(image.Point2D(i)) - host::Xy(true_image.Point2D(i));
      EXPECT_LE(error.norm(), options.max_outlier);
      if (error.norm() < options.min_outlier - 1e-9) {
        sum2 += error.squaredNorm();
        sum += error.sum();
        ++num_inliers;
      } else {
        ++num_outliers;
      }
    }
  }
  const double num_observations = frame.num_observations;
  EXPECT_EQ(num_outliers, frame.num_outliers);
  EXPECT_EQ(num_inliers + num_outliers, frame.num_observations);
  EXPECT_NEAR(num_outliers / num_observations, 0.1, 0.012);
  EXPECT_NEAR(std::sqrt(sum2 / (2.0 * num_inliers)), 0.7, 0.02);
  EXPECT_NEAR(sum / (2.0 * num_inliers), 0.0, 0.02);
  EXPECT_NEAR(num_keypoints / num_observations, 1.2, 0.01);
  for (const auto& [id, point] : frame.sfm_model.Points3D()) {
    EXPECT_GE(host::TrackOf(point).Length(), 3);
    EXPECT_LE(host::TrackOf(point).Length(), 6);
  }
}

TEST_F(SimulatorTest, FramesHaveTheirOwnGaugeAndWrongIntrinsics) {
  SimulatorOptions options = SmallOptions();
  options.noise = 0.0;
  options.outlier_share = 0.0;
  options.initial_focal_length_sigma = 0.0;
  options.initial_principal_point_sigma = 0.0;
  options.initial_distortion_sigma = 0.0;
  const SimulatedCapture exact = SimulateCapture(options);
  for (const SimulatedFrame& frame : exact.frames) {
    for (const auto& [id, point] : frame.sfm_model.Points3D()) {
      const Eigen::Vector3d expected =
          frame.sfm_from_rig * host::Xyz(frame.true_model.Point3D(id));
      EXPECT_LT((host::Xyz(point) - expected).norm(), 1e-6);
    }
  }
  EXPECT_GT(std::abs(exact.frames[0].sfm_from_rig.scale -
                     exact.frames[1].sfm_from_rig.scale),
            1e-3);
  EXPECT_NE(host::Xyz(exact.frames[0].true_model.Point3D(1)),
            host::Xyz(exact.frames[1].true_model.Point3D(1)));

  options.initial_focal_length_sigma = 0.01;
  const SimulatedCapture drifted = SimulateCapture(options);
  double sum2 = 0.0;
  for (const SimulatedFrame& frame : drifted.frames) {
    for (const auto& [id, camera] : frame.sfm_model.Cameras()) {
      const RigCamera& truth = drifted.true_cameras[id - 1];
      sum2 += std::pow(host::Params(camera)[0] / truth.params[0] - 1.0, 2);
      EXPECT_EQ(host::Params(camera)[2], truth.params[2]);
    }
    EXPECT_LT(frame.sfm_model.ComputeMeanReprojectionError(), 0.5);
  }
  EXPECT_GT(std::sqrt(sum2 / 12), 0.003);
  EXPECT_LT(std::sqrt(sum2 / 12), 0.03);
  // Extrinsics are known exactly unless asked otherwise.
  EXPECT_EQ(drifted.known_cameras[0].cam_from_world.translation,
            drifted.true_cameras[0].cam_from_world.translation);
  EXPECT_NE(drifted.known_cameras[0].params, drifted.true_cameras[0].params);
}

TEST_F(SimulatorTest, UnitOnlyScalesTheWorld) {
  SimulatorOptions options = SmallOptions();
  options.num_frames = 1;
  const SimulatedCapture metres = SimulateCapture(options);
  options.unit = "mm";
  const SimulatedCapture millimetres = SimulateCapture(options);
  const Rigid3& a = metres.true_cameras[3].cam_from_world;
  const Rigid3& b = millimetres.true_cameras[3].cam_from_world;
  EXPECT_LT((1000.0 * a.translation - b.translation).norm(), 1e-9);
  const auto& point_m = metres.frames[0].true_model.Point3D(5);
  const auto& point_mm = millimetres.frames[0].true_model.Point3D(5);
  EXPECT_LT((1000.0 * host::Xyz(point_m) - host::Xyz(point_mm)).norm(), 1e-9);
}

// Bilinear grey value of an image at a COLMAP image coordinate.
double Grey(const GreyImage& image, const Eigen::Vector2d& xy) {
  const double x = xy.x() - 0.5, y = xy.y() - 0.5;
  const int x0 = static_cast<int>(x), y0 = static_cast<int>(y);
  const double dx = x - x0, dy = y - y0;
  const uint8_t* p = &image.pixels[y0 * image.width + x0];
  return (1 - dy) * ((1 - dx) * p[0] + dx * p[1]) +
         dy * ((1 - dx) * p[image.width] + dx * p[image.width + 1]);
}

TEST_F(SimulatorTest, ImagesAgreeWithGeometry) {
  SimulatorOptions options = SmallOptions();
  options.image_width = 320;
  options.image_height = 400;
  options.num_points = 300;
  options.max_view_angle = 40.0;
  options.blur = 0.0;
  options.image_noise = 0.0;
  const SimulatedCapture capture = SimulateCapture(options);
  const size_t kFrame = 1;
  const host::Reconstruction& truth = capture.frames[kFrame].true_model;
  const SyntheticSurface surface = SimulatedSurface(options, kFrame);
  std::map<host::image_t, GreyImage> images;
  for (const auto& [id, image] : truth.Images()) {
    images[id] = RenderSimulatedImage(capture, kFrame, id - 1);
  }
  // Of the true position, and of one that is a pixel off: the truth must be far
  // better, or the test would not notice a shift.
  double sum = 0.0, shifted_sum = 0.0;
  size_t count = 0;
  for (const auto& [id, point] : truth.Points3D()) {
    const double expected =
        255.0 * surface.Brightness(host::Xyz(point).normalized());
    EXPECT_NEAR(host::Xyz(point).norm(),
                surface.Radius(host::Xyz(point).normalized()),
                1e-12);
    for (const auto& element : host::TrackOf(point).Elements()) {
      const Eigen::Vector2d xy =
          host::Xy(truth.Image(element.image_id).Point2D(element.point2D_idx));
      const GreyImage& image = images.at(element.image_id);
      sum += std::abs(Grey(image, xy) - expected);
      shifted_sum +=
          std::abs(Grey(image, xy + Eigen::Vector2d(0.5, 0.5)) - expected);
      ++count;
    }
  }
  ASSERT_GT(count, 500);
  EXPECT_LT(sum / count, 6.0);
  EXPECT_GT(shifted_sum / count, 1.5 * sum / count);
}

// Each camera sees them elsewhere on the surface, on top of its brightness.
TEST_F(SimulatorTest, ReflectionsWander) {
  SimulatorOptions options = SmallOptions();
  options.image_noise = 0.0;
  const SimulatedCapture dull = SimulateCapture(options);
  options.gloss = 0.3;
  const SimulatedCapture shiny = SimulateCapture(options);
  size_t num_bright = 0;
  const GreyImage before = RenderSimulatedImage(dull, 0, 0);
  const GreyImage after = RenderSimulatedImage(shiny, 0, 0);
  for (size_t i = 0; i < before.pixels.size(); ++i) {
    EXPECT_GE(after.pixels[i], before.pixels[i]);
    num_bright += after.pixels[i] > before.pixels[i] + 10;
  }
  EXPECT_GT(num_bright, before.pixels.size() / 100);

  const SyntheticSurface surface = SimulatedSurface(options, 0);
  size_t num_different = 0, num_points = 0;
  for (const auto& id_and_point : shiny.frames[0].true_model.Points3D()) {
    const Eigen::Vector3d& xyz = host::Xyz(id_and_point.second);
    std::vector<double> seen;
    for (const size_t i : {0, 1}) {
      const Eigen::Vector3d center =
          shiny.true_cameras[i].cam_from_world.Center();
      seen.push_back(
          surface.Reflection(xyz.normalized(), (xyz - center).normalized()));
      EXPECT_GE(seen.back(), 0.0);
      EXPECT_LE(seen.back(), options.gloss);
    }
    num_different += std::abs(seen[0] - seen[1]) > 0.05;
    ++num_points;
  }
  EXPECT_GT(num_different, num_points / 5);
}

TEST_F(SimulatorTest, MissingImagesAreMissingEverywhere) {
  SimulatorOptions options = SmallOptions();
  options.num_cameras = 12;
  options.num_frames = 3;
  options.missing_share = 0.3;
  const SimulatedCapture capture = SimulateCapture(options);
  const auto files = Files(options, "capture");
  size_t num_missing = 0;
  for (const SimulatedFrame& frame : capture.frames) {
    for (size_t i = 0; i < frame.has_image.size(); ++i) {
      const std::string name =
          "images/" + frame.name + "/" + capture.true_cameras[i].name + ".png";
      EXPECT_EQ(files.count(name), frame.has_image[i]);
      EXPECT_FALSE(!frame.has_image[i] && frame.sfm_model.ExistsImage(i + 1));
      num_missing += !frame.has_image[i];
    }
  }
  EXPECT_GT(num_missing, 3);
  EXPECT_LT(num_missing, 20);
}

TEST_F(SimulatorTest, BadOptionsAreUsageErrors) {
  const auto expect_usage_error = [](const auto& change) {
    SimulatorOptions options = SmallOptions();
    change(&options);
    EXPECT_THROW(SimulateCapture(options), UsageError);
  };
  using O = SimulatorOptions*;
  expect_usage_error([](O o) { o->num_cameras = 1; });
  expect_usage_error([](O o) { o->num_frames = 0; });
  expect_usage_error([](O o) { o->num_points = -5; });
  expect_usage_error([](O o) { o->image_width = 0; });
  expect_usage_error([](O o) { o->camera_model = "PINHOLES"; });
  expect_usage_error([](O o) { o->unit = "inch"; });
  expect_usage_error([](O o) { o->noise = NAN; });
  expect_usage_error([](O o) { o->outlier_share = 1.5; });
  expect_usage_error([](O o) { o->min_views = 7; });
  expect_usage_error([](O o) { o->max_views = 2; });
  expect_usage_error([](O o) { o->min_outlier = 20.0; });
  expect_usage_error([](O o) { o->focal_length = 10.0; });
  expect_usage_error([](O o) { o->distortion = 0.5; });
  expect_usage_error([](O o) { o->num_threads = 0; });
  expect_usage_error([](O o) { o->seed = -1; });
  // No point is seen by all cameras of a full ring.
  expect_usage_error([](O o) {
    o->azimuth = 180.0;
    o->num_cameras = o->min_views = 10;
  });
}

TEST_F(SimulatorTest, ForeignFoldersAreNotOverwritten) {
  SimulatorOptions options = SmallOptions();
  options.render_images = false;
  options.num_frames = 1;
  const fs::path path = folder_ / "capture";
  fs::create_directories(path);
  std::ofstream(path / "diary.txt") << "mine";
  SimulatedCapture capture = SimulateCapture(options);
  EXPECT_THROW(WriteSimulatedCapture(capture, path.string()), OutputError);
  capture.options.overwrite = true;
  EXPECT_THROW(WriteSimulatedCapture(capture, path.string()), OutputError);
  EXPECT_TRUE(fs::exists(path / "diary.txt"));
  fs::remove(path / "diary.txt");
  WriteSimulatedCapture(capture, path.string());
  WriteSimulatedCapture(capture, path.string());
  EXPECT_FALSE(fs::exists(path / "images"));
  capture.options.overwrite = false;
  EXPECT_THROW(WriteSimulatedCapture(capture, path.string()), OutputError);
}

TEST_F(SimulatorTest, CommandWritesItsOptionsAndReturnsExitCodes) {
  const auto run = [&](std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), "multi_frame_simulator");
    std::vector<char*> argv;
    for (std::string& argument : arguments) {
      argv.push_back(&argument[0]);
    }
    return RunMultiFrameSimulator(static_cast<int>(argv.size()), argv.data());
  };
  const std::string first = (folder_ / "first").string();
  const std::string second = (folder_ / "second").string();
  const std::string ini = first + "/project.ini";
  EXPECT_EQ(run({"--output_path",
                 first,
                 "--Simulator.quiet",
                 "1",
                 "--Simulator.render_images",
                 "0",
                 "--Simulator.num_points",
                 "150",
                 "--Simulator.unit",
                 "mm"}),
            kExitSuccess);
  // The written options make the same capture again.
  EXPECT_EQ(run({"--project_path", ini, "--output_path", second}),
            kExitSuccess);
  std::ifstream a(first + "/simulation.json"), b(second + "/simulation.json");
  const std::string summary(std::istreambuf_iterator<char>(a), {});
  EXPECT_EQ(summary, std::string(std::istreambuf_iterator<char>(b), {}));
  EXPECT_NE(summary.find("\"unit\": \"mm\""), std::string::npos);
  EXPECT_EQ(run({"--project_path", ini}), kExitOutput);
  EXPECT_EQ(run({"--output_path", second, "--Simulator.noise", "-1"}),
            kExitUsage);
}

}  // namespace
}  // namespace mfir
