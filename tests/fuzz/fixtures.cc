#include "tests/fuzz/fixtures.h"

#include <cmath>

#include "colmap_ext/feature/feature_database.h"
#include "colmap_ext/host/database.h"
#include "colmap_ext/models/camera_models.h"
#include "colmap_ext/models/model_io.h"
#include "tests/support/test_files.h"

namespace mfir {
namespace {

constexpr size_t kNumPoints = 12;

Eigen::Vector3d FixturePoint(size_t i) {
  const double angle = 0.7 * static_cast<double>(i);
  return {std::cos(angle), std::sin(angle), 5.0 + 0.1 * angle};
}

Eigen::Vector2d FixtureKeypoint(const RigCamera& camera, size_t i) {
  const Eigen::Vector3d x = FixturePoint(i) + camera.cam_from_world.translation;
  return {500.0 * x.x() / x.z() + 320.0, 500.0 * x.y() / x.z() + 240.0};
}

void WriteImage(const RigCamera& camera,
                host::image_t image_id,
                host::Database* database) {
  host::Image image;
  image.SetImageId(image_id);
  image.SetCameraId(image_id);
  image.SetName(camera.name + ".png");
  host::WriteImageWithTrivialFrame(
      host::MakeCamera(image_id,
                       CameraModelId(*camera.model),
                       camera.width,
                       camera.height,
                       camera.params),
      image,
      database);
  host::FeatureKeypoints keypoints;
  host::FeatureDescriptors descriptors = host::MakeSiftDescriptors(kNumPoints);
  for (size_t i = 0; i < kNumPoints; ++i) {
    const Eigen::Vector2d xy = FixtureKeypoint(camera, i);
    keypoints.emplace_back(static_cast<float>(xy.x()),
                           static_cast<float>(xy.y()));
    descriptors.data(i, i) = 255;
  }
  database->WriteKeypoints(image_id, keypoints);
  host::WriteDescriptors(image_id, descriptors, database);
}

// With few and small pages: less for a fuzzer to search.
std::string CompactDatabase(const std::string& path) {
  {
    SqliteFile file(path, SQLITE_OPEN_READWRITE);
    file.Execute("PRAGMA journal_mode = DELETE");
    file.Execute("PRAGMA page_size = 512");
    file.Execute("VACUUM");
  }
  return ReadFile(path);
}

}  // namespace

const std::vector<RigCamera>& FixtureCameras() {
  static const std::vector<RigCamera> cameras = [] {
    RigCamera a;
    a.name = "a";
    a.model = FindCameraModel("PINHOLE");
    a.width = 640;
    a.height = 480;
    a.params = {500.0, 500.0, 320.0, 240.0};
    RigCamera b = a;
    b.name = "b";
    b.cam_from_world.translation.x() = -1.0;
    return std::vector<RigCamera>{a, b};
  }();
  return cameras;
}

std::string FixtureFrameDatabase() {
  const TemporaryFolder folder;
  const std::string path = folder / "frame.db";
  {
    const auto database = host::OpenDatabase(path);
    host::FeatureMatches matches;
    for (size_t i = 0; i < kNumPoints; ++i) {
      matches.emplace_back(static_cast<uint32_t>(i), static_cast<uint32_t>(i));
    }
    for (const host::image_t id : {1, 2}) {
      WriteImage(FixtureCameras()[id - 1], id, database.get());
    }
    database->WriteMatches(1, 2, matches);
  }
  return CompactDatabase(path);
}

DenseFeatureRequest FixtureFeatureRequest() {
  return {"f", "a", "a.png", 200, 100, {{20.0, 30.0}, {50.2, 60.9}}, {3, 1}};
}

std::string FixtureFeatureDatabase() {
  struct Source : DenseFeatureSource {
    DenseFeaturePatches Extract(const DenseFeatureRequest& request) override {
      DenseFeaturePatches patches = PlacePatches(request, 4, 2, 1.0);
      patches.data[3] = 0x3C00;
      return patches;
    }
  };
  const TemporaryFolder folder;
  const std::string path = folder / "features.db";
  const auto source =
      MakeWritingFeatureSource(std::make_unique<Source>(), path);
  source->Extract(FixtureFeatureRequest());
  source->Finish();
  return CompactDatabase(path);
}

void WriteFixtureResult(const std::string& path) {
  host::Reconstruction model;
  for (const host::image_t id : {1, 2}) {
    const RigCamera& camera = FixtureCameras()[id - 1];
    AddPosedImage(id, camera.name + ".png", id, camera, &model);
  }
  WriteModel(path + "/rig", /*with_text=*/false, model);
  WriteModel(path + "/frames/f", /*with_text=*/false, model);
}

std::string FixtureSummary() {
  return R"({"schema_version": 1, "created": "2026-11-30T08:15:00Z",
"tool": {"version": "0.1", "colmap_version": "3.8", "git": "0"},
"options": {"MultiFrame.preset": "accurate"},
"inputs": {"input_path": "F", "extrinsics_path": "R", "extrinsics_format":
 "colmap", "image_path": "", "num_rig_cameras": 2, "cameras_without_images": [],
 "images_without_camera": []},
"frames": [{"name": "f", "status": "used", "reason": "", "num_images": 2,
 "num_points": 0, "num_observations": 0, "alignment_rms": 0.1}],
"cameras": [
 {"name": "a", "model": "PINHOLE", "width": 640, "height": 480,
  "params": [500, 500, 320, 240], "params_initial": [501, 502, 321, 242],
  "params_std": [0.1, 0.1, 0.2, 0], "correlations": [[1, 0.9, 0, 0],
  [0.9, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], "num_frames": 1,
  "num_observations": 9, "rms_px_before": 2.0, "rms_px_after": 0.2,
  "flags": ["weak"]},
 {"name": "b", "model": "PINHOLE", "width": 640, "height": 480,
  "params": [500, 500, 320, 240], "params_initial": [501, 502, 321, 242],
  "params_std": [0.1, 0.1, 0.2, 0.1], "correlations": [[1, 0, 0, 0],
  [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], "num_frames": 1,
  "num_observations": 9, "rms_px_before": 2.0, "rms_px_after": null,
  "rig": {"model": "PINHOLE", "params": [490, 490, 320, 240]}, "flags": []}],
"stages": [{"index": 0, "weights": {}, "iterations": 3, "time_s": 0.1,
 "cost": {"reprojection": 1.5}, "termination": "converged"}],
"result": {"status": "converged", "rms_px_before": 2.0, "rms_px_after": 0.2,
 "held_out_rms_px": 0.3, "noise_std_px": 0.2, "max_inlier_px": 0.9},
"timings_s": {"total": 1.0}, "peak_rss_bytes": 100000}
)";
}

}  // namespace mfir
