// Writing of simulated captures.

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <nlohmann/json.hpp>

#include "colmap_ext/host/image_file.h"
#include "colmap_ext/io/work_folder.h"
#include "colmap_ext/models/camera_models.h"
#include "colmap_ext/models/model_io.h"
#include "colmap_ext/rigs/rig_io.h"
#include "colmap_ext/simulation/simulator.h"
#include "src/parallel/parallel_for.h"
#include "src/util/errors.h"
#include "src/util/interruption.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr char kSimulationFile[] = "simulation.json";

// COLMAP's writers do not notice a full disk.
void CheckDiskSpace(const fs::path& path) {
  constexpr std::uintmax_t kMinSpace = 1 << 20;
  if (fs::space(path).available < kMinSpace) {
    throw OutputError(path.string() +
                      ": the disk is full. Free some space, or simulate less.");
  }
}

void WriteRig(const std::vector<RigCamera>& cameras, const fs::path& path) {
  host::Reconstruction model;
  for (size_t i = 0; i < cameras.size(); ++i) {
    const auto id = static_cast<host::image_t>(i + 1);
    AddPosedImage(id, cameras[i].name + ".png", id, cameras[i], &model);
  }
  WriteTextModel(path.string(), model);
}

bool CanKRTHold(const std::string& model_name) {
  for (const char* name :
       {"SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"}) {
    if (model_name == name) {
      return true;
    }
  }
  return false;
}

void WriteKnownCamerasAsKRT(const std::vector<RigCamera>& cameras,
                            const fs::path& path) {
  std::vector<KnownCamera> known_cameras;
  for (const RigCamera& camera : cameras) {
    KnownCamera known_camera;
    known_camera.name = camera.name;
    known_camera.image_name = camera.name + ".png";
    known_camera.cam_from_world = camera.cam_from_world;
    known_camera.model = camera.model;
    known_camera.width = camera.width;
    known_camera.height = camera.height;
    known_camera.params = camera.params;
    known_cameras.push_back(known_camera);
  }
  WriteKRT(path.string(), known_cameras);
}

void WriteImage(const GreyImage& image, const fs::path& path) {
  host::Bitmap bitmap = host::MakeBitmap(static_cast<int>(image.width),
                                         static_cast<int>(image.height),
                                         /*as_rgb=*/false);
  for (size_t y = 0; y < image.height; ++y) {
    for (size_t x = 0; x < image.width; ++x) {
      bitmap.SetPixel(
          x, y, host::BitmapColor(image.pixels[y * image.width + x]));
    }
  }
  if (!bitmap.Write(path.string())) {
    throw OutputError(path.string() + ": cannot write the image.");
  }
}

void WriteFrame(const SimulatedCapture& capture,
                size_t frame_idx,
                const fs::path& path) {
  const SimulatedFrame& frame = capture.frames[frame_idx];
  const fs::path sfm_path = path / "frames" / frame.name / "sparse" / "0";
  WriteModel(sfm_path.string(), /*with_text=*/false, frame.sfm_model);
  const fs::path true_path = path / "ground_truth_frames" / frame.name;
  WriteModel(true_path.string(), /*with_text=*/false, frame.true_model);

  if (capture.options.render_images) {
    const fs::path image_path = path / "images" / frame.name;
    fs::create_directories(image_path);
    ParallelFor(capture.true_cameras.size(),
                capture.options.num_threads,
                [&](size_t i) {
                  if (frame.has_image[i]) {
                    WriteImage(
                        RenderSimulatedImage(capture, frame_idx, i),
                        image_path / (capture.true_cameras[i].name + ".png"));
                  }
                });
  }
  CheckDiskSpace(path);
}

Json Summary(const SimulatedCapture& capture) {
  Json options;
  VisitSimulatorOptions(
      &capture.options,
      [&options](const char* name, const auto* value, const char*) {
        options[name] = *value;
      });
  Json frames = Json::array();
  size_t num_images = 0, num_points = 0, num_observations = 0, num_outliers = 0;
  for (const SimulatedFrame& frame : capture.frames) {
    const Similarity3& gauge = frame.sfm_from_rig;
    const size_t num_frame_images =
        std::count(frame.has_image.begin(), frame.has_image.end(), true);
    const Eigen::Quaterniond& q = gauge.rotation;
    const Eigen::Vector3d& t = gauge.translation;
    frames.push_back({{"name", frame.name},
                      {"num_images", num_frame_images},
                      {"num_registered_images", frame.sfm_model.NumRegImages()},
                      {"num_points", frame.sfm_model.NumPoints3D()},
                      {"num_observations", frame.num_observations},
                      {"num_outliers", frame.num_outliers},
                      {"sfm_from_rig",
                       {{"scale", gauge.scale},
                        {"rotation_wxyz", {q.w(), q.x(), q.y(), q.z()}},
                        {"translation", {t.x(), t.y(), t.z()}}}}});
    num_images += num_frame_images;
    num_points += frame.sfm_model.NumPoints3D();
    num_observations += frame.num_observations;
    num_outliers += frame.num_outliers;
  }
  return {{"schema_version", 1},
          {"options", options},
          {"totals",
           {{"num_cameras", capture.true_cameras.size()},
            {"num_frames", capture.frames.size()},
            {"num_images", num_images},
            {"num_points", num_points},
            {"num_observations", num_observations},
            {"num_outliers", num_outliers}}},
          {"frames", frames}};
}

void WriteSummary(const SimulatedCapture& capture, const fs::path& path) {
  std::ofstream file(path);
  file << Summary(capture).dump(2) << std::endl;
  if (!file) {
    throw OutputError(path.string() + ": cannot write the file.");
  }
}

void WriteAll(const SimulatedCapture& capture, const fs::path& path) {
  fs::create_directories(path);
  WriteRig(capture.known_cameras, path / "rig");
  WriteRig(capture.true_cameras, path / "ground_truth");
  if (CanKRTHold(capture.options.camera_model)) {
    WriteKnownCamerasAsKRT(capture.known_cameras, path / "KRT");
  }
  for (size_t i = 0; i < capture.frames.size(); ++i) {
    WriteFrame(capture, i, path);
    const SimulatedFrame& frame = capture.frames[i];
    if (!capture.options.quiet) {
      std::cout << "Wrote frame " << i + 1 << " of " << capture.frames.size()
                << ": " << frame.sfm_model.NumRegImages() << " images, "
                << frame.sfm_model.NumPoints3D() << " points, "
                << frame.num_observations << " observations ("
                << frame.num_outliers << " outliers)" << std::endl;
    }
  }
  WriteSummary(capture, path / kSimulationFile);
}

}  // namespace

void CheckSimulatorOutput(const SimulatorOptions& options,
                          const std::string& output_path) {
  const fs::path path = output_path;
  std::error_code error;
  const bool exists = fs::exists(path, error);
  if (error) {
    throw OutputError("--output_path " + path.string() + ": " +
                      error.message() + ".");
  }
  if (!exists || (fs::is_directory(path) && fs::is_empty(path))) {
    return;
  }
  if (!fs::is_directory(path)) {
    throw OutputError(path.string() +
                      ": is a file. Choose another --output_path.");
  }
  if (!options.overwrite) {
    throw OutputError(path.string() +
                      ": is not empty. Choose another --output_path, or pass "
                      "--Simulator.overwrite 1.");
  }
  if (!fs::exists(path / kSimulationFile)) {
    throw OutputError(path.string() +
                      ": is not a simulated capture and will not be "
                      "overwritten. Choose another --output_path.");
  }
}

void WriteSimulatedCapture(
    const SimulatedCapture& capture,
    const std::string& output_path,
    const std::function<void(const std::string&)>& write_more) {
  // Without a trailing slash, so that names can be derived.
  fs::path path = fs::absolute(output_path).lexically_normal();
  if (!path.has_filename()) {
    path = path.parent_path();
  }
  try {
    CheckSimulatorOutput(capture.options, path.string());
    fs::create_directories(path.parent_path());
    const WorkFolder folder(WorkFolder::Beside(path));
    const fs::path partial_path = folder.Path() / "capture";
    WriteAll(capture, partial_path);
    if (write_more) {
      write_more(partial_path.string());
    }
    CheckDiskSpace(partial_path);
    // The old capture goes, with the work folder, only when the new one is
    // complete.
    const SignalDelay delay;
    if (fs::exists(path)) {
      fs::rename(path, folder.Path() / "old");
    }
    fs::rename(partial_path, path);
  } catch (const fs::filesystem_error& error) {
    throw OutputError(output_path + ": cannot be written (" +
                      error.code().message() + ").");
  }
}

}  // namespace mfir
