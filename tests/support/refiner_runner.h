// Runs the commands on small simulated captures.

#pragma once

#include <sys/wait.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "colmap_ext/host/reconstruction.h"
#include "colmap_ext/models/model_io.h"
#include "colmap_ext/simulation/simulator.h"
#include "tests/support/test_files.h"

namespace mfir {

struct CommandResult {
  int exit_code = -1;  // 128 + signal after a crash
  std::string output;
  std::string error;
};

// Runs a shell command line.
inline CommandResult RunShell(const std::string& command_line) {
  const TemporaryFolder folder;
  const int status = std::system(("(" + command_line + ") </dev/null >" +
                                  folder / "output" + " 2>" + folder / "error")
                                     .c_str());
  CommandResult result;
  result.exit_code =
      WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  result.output = ReadFile(folder / "output");
  result.error = ReadFile(folder / "error");
  return result;
}

inline std::string ShellQuoted(const std::string& text) {
  std::string quoted = "'";
  for (const char c : text) {
    quoted += c == '\'' ? std::string("'\\''") : std::string(1, c);
  }
  return quoted + "'";
}

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
inline constexpr int kSlowness = 10;
#else
inline constexpr int kSlowness = 1;
#endif

// Runs the program of the build, or the one that the environment variable
// MFIR_COLMAP_EXE names; `limit_s` ends a run that hangs (exit code 124).
inline CommandResult RunColmap(const std::vector<std::string>& arguments,
                               int limit_s = 60) {
  const char* program = std::getenv("MFIR_COLMAP_EXE");
  std::string command_line =
      "timeout " + std::to_string(kSlowness * limit_s) + " " +
      ShellQuoted(program != nullptr ? program : MFIR_COLMAP_EXE);
  for (const std::string& argument : arguments) {
    command_line += " " + ShellQuoted(argument);
  }
  return RunShell(command_line);
}

// 8 cameras, 3 frames: refined in less than 0.1 s.
inline SimulatorOptions SmallCapture() {
  SimulatorOptions options;
  options.num_cameras = 8;
  options.num_frames = 3;
  options.num_points = 150;
  options.azimuth = 60.0;
  options.image_width = 640;
  options.image_height = 480;
  options.render_images = false;
  options.quiet = true;
  return options;
}

// With images. Lenses with distortion; RIG has intrinsics that are 1 % wrong.
inline SimulatorOptions RenderedCapture() {
  SimulatorOptions options;
  options.num_cameras = 10;
  options.num_frames = 2;
  options.num_points = 50;
  options.min_views = 2;
  options.max_views = 10;
  options.azimuth = 45.0;
  options.min_elevation = -15.0;
  options.max_elevation = 25.0;
  options.image_width = 280;
  options.image_height = 280;
  options.principal_point_sigma = 3.0;
  options.initial_principal_point_sigma = 3.0;
  options.camera_model = "OPENCV";
  options.quiet = true;
  return options;
}

// Options by name, without dashes.
using CommandOptions = std::map<std::string, std::string>;
// Parameters by camera name.
using CameraParams = std::map<std::string, std::vector<double>>;

// Each test works on a copy of one capture in folder_.
class RefinerTest : public testing::Test {
 protected:
  static constexpr const char* kFrames[] = {
      "frame000000", "frame000001", "frame000002"};

  static void SetUpTestSuite() {
    original_ = new TemporaryFolder;
    WriteSimulatedCapture(SimulateCapture(SmallCapture()),
                          *original_ / "capture");
  }
  static void TearDownTestSuite() { delete original_; }

  void SetUp() override {
    std::filesystem::copy(*original_ / "capture",
                          folder_.Path(),
                          std::filesystem::copy_options::recursive);
  }

  std::string Path(const std::string& name) const { return folder_ / name; }
  std::string ModelPath(const std::string& frame) const {
    return Path("frames/" + frame + "/sparse/0");
  }

  // Refines frames/ with rig/ into out/ unless `options` say otherwise; an
  // option with the value "-" is left out.
  CommandResult Refine(const CommandOptions& options = {},
                       int limit_s = 60) const {
    CommandOptions all = {{"input_path", Path("frames")},
                          {"extrinsics_path", Path("rig")},
                          {"output_path", Path("out")},
                          // Threads that spin slow a busy machine down.
                          {"MultiFrame.num_threads", "1"}};
    for (const auto& [name, value] : options) all[name] = value;
    std::vector<std::string> arguments = {"multi_frame_intrinsics_refiner"};
    for (const auto& [name, value] : all) {
      if (value == "-") continue;
      arguments.push_back("--" + name);
      arguments.push_back(value);
    }
    return RunColmap(arguments, limit_s);
  }

  // The same, expecting success.
  void ExpectRefines(const CommandOptions& options = {}) const {
    const CommandResult result = Refine(options);
    ASSERT_EQ(result.exit_code, kExitSuccess)
        << testing::PrintToString(options) << result.error;
  }

  // Expects the exit code and all parts in the message, on stderr, which
  // begins with `begin`.
  void ExpectError(int exit_code,
                   const std::vector<std::string>& parts,
                   const CommandOptions& options = {},
                   const std::string& begin = "ERROR") const {
    const CommandResult result = Refine(options);
    EXPECT_EQ(result.exit_code, exit_code) << result.error;
    EXPECT_EQ(result.error.find(begin), 0) << result.error;
    for (const std::string& part : parts) {
      EXPECT_NE(result.error.find(part), std::string::npos)
          << "'" << part << "' is not in: " << result.error;
    }
  }

  nlohmann::json Summary(const std::string& output = "out") const {
    return nlohmann::json::parse(ReadFile(Path(output + "/summary.json")));
  }

  CameraParams Params(const std::string& output = "out",
                      const std::string& key = "params") const {
    const nlohmann::json summary = Summary(output);
    CameraParams params;
    for (const nlohmann::json& camera : summary["cameras"]) {
      for (const nlohmann::json& value : camera[key]) {
        params[camera["name"]].push_back(value.is_null() ? NAN
                                                         : value.get<double>());
      }
    }
    return params;
  }

  // All files of a folder by relative path.
  std::map<std::string, std::string> Files(const std::string& name) const {
    std::map<std::string, std::string> files;
    for (const auto& entry :
         std::filesystem::recursive_directory_iterator(Path(name))) {
      if (entry.is_regular_file()) {
        files[std::filesystem::relative(entry.path(), Path(name)).string()] =
            ReadFile(entry.path().string());
      }
    }
    return files;
  }

  static host::Reconstruction Read(const std::string& path) {
    // COLMAP aborts where there is none.
    if (!IsModelFolder(path)) throw std::runtime_error("no model: " + path);
    host::Reconstruction reconstruction;
    const bool is_binary = std::filesystem::exists(path + "/points3D.bin");
    host::ReadReconstruction(path, is_binary, &reconstruction);
    return reconstruction;
  }

  static void WriteBinary(const host::Reconstruction& reconstruction,
                          const std::string& path) {
    std::filesystem::create_directories(path);
    reconstruction.WriteBinary(path);
  }

  static void WriteText(const host::Reconstruction& reconstruction,
                        const std::string& path) {
    std::filesystem::create_directories(path);
    reconstruction.WriteText(path);
  }

  // Changes the sparse model of a frame.
  template <typename Change>
  void ChangeFrame(const std::string& frame, const Change& change) const {
    host::Reconstruction reconstruction = Read(ModelPath(frame));
    change(&reconstruction);
    WriteBinary(reconstruction, ModelPath(frame));
  }

  // Changes the models of all frames.
  template <typename Change>
  void ChangeFrames(const Change& change) const {
    for (const char* frame : kFrames) {
      ChangeFrame(frame, change);
    }
  }

  // Changes the known extrinsics.
  template <typename Change>
  void ChangeRig(const Change& change) const {
    host::Reconstruction rig = Read(Path("rig"));
    change(&rig);
    WriteText(rig, Path("rig"));
  }

  // Gives all images of `path` (a model in text form for RIG, else binary)
  // other names.
  template <typename NewName>
  static void RenameImages(const NewName& new_name,
                           host::Reconstruction* reconstruction) {
    for (const auto& id_and_image : reconstruction->Images()) {
      host::Image& image = reconstruction->Image(id_and_image.first);
      image.SetName(new_name(image.Name()));
    }
  }

  // `qvec`: w, x, y, z.
  static void SetPose(host::image_t image_id,
                      const Eigen::Vector4d& qvec,
                      const Eigen::Vector3d& translation,
                      host::Reconstruction* reconstruction) {
    host::SetCamFromWorld(
        {Eigen::Quaterniond(qvec(0), qvec(1), qvec(2), qvec(3)), translation},
        &reconstruction->Image(image_id));
  }

  static void SetTranslation(host::image_t image_id,
                             const Eigen::Vector3d& translation,
                             host::Reconstruction* reconstruction) {
    host::Image& image = reconstruction->Image(image_id);
    host::SetCamFromWorld({host::CamFromWorld(image).rotation, translation},
                          &image);
  }

  static void RemovePoints(host::Reconstruction* reconstruction) {
    for (const host::point3D_t id : reconstruction->Point3DIds()) {
      reconstruction->DeletePoint3D(id);
    }
  }

  // Removes all images but the first `num_images` by id, as a model that was
  // registered in part.
  static void KeepImages(size_t num_images,
                         host::Reconstruction* reconstruction) {
    std::vector<host::image_t> ids = reconstruction->RegImageIds();
    std::sort(ids.begin(), ids.end());
    for (size_t i = num_images; i < ids.size(); ++i) {
      host::DeRegisterImage(ids[i], reconstruction);
    }
    reconstruction->TearDown();
  }

  TemporaryFolder folder_;
  static inline TemporaryFolder* original_ = nullptr;
};

// Has the result for the capture as it was made, in reference/.
class RefinerReferenceTest : public RefinerTest {
 protected:
  void SetUp() override {
    RefinerTest::SetUp();
    ExpectRefines({{"output_path", Path("reference")}});
    reference_ = Params("reference");
  }

  CameraParams reference_;
};

inline double MaxRelativeDifference(const CameraParams& a,
                                    const CameraParams& b) {
  if (a.empty() || a.size() != b.size()) return HUGE_VAL;
  double max_difference = 0.0;
  for (const auto& [name, params] : a) {
    if (b.count(name) == 0 || b.at(name).size() != params.size()) {
      return HUGE_VAL;
    }
    for (size_t i = 0; i < params.size(); ++i) {
      const double difference = std::abs(params[i] - b.at(name)[i]) /
                                std::max(1.0, std::abs(params[i]));
      if (!(difference <= max_difference)) max_difference = difference;
    }
  }
  return max_difference;
}

// Largest error of a parameter in units of its reported standard deviation.
inline double MaxErrorInStds(const CameraParams& params,
                             const CameraParams& stds,
                             const CameraParams& truth) {
  double max_error = 0.0;
  for (const auto& [name, values] : params) {
    for (size_t i = 0; i < values.size(); ++i) {
      const double error =
          std::abs(values[i] - truth.at(name)[i]) / stds.at(name)[i];
      if (!(error <= max_error)) max_error = error;
    }
  }
  return max_error;
}

inline CameraParams TrueParams(const SimulatedCapture& capture) {
  CameraParams params;
  for (const RigCamera& camera : capture.true_cameras) {
    params[camera.name] = camera.params;
  }
  return params;
}

}  // namespace mfir
