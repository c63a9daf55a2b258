// The command multi_frame_triangulator: frames from images and known
// extrinsics.

#include <algorithm>
#include <atomic>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <map>
#include <mutex>
#include <nlohmann/json.hpp>
#include <set>

#include "colmap_ext/camera_models.h"
#include "colmap_ext/command.h"
#include "colmap_ext/frame_database.h"
#include "colmap_ext/frame_triangulation.h"
#include "colmap_ext/frames.h"
#include "colmap_ext/model_check.h"
#include "colmap_ext/rig_io.h"
#include "colmap_ext/triangulator_options.h"
#include "src/camera_naming.h"
#include "src/errors.h"
#include "src/parallel_for.h"
#include "src/view_overlap.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

// Within FRAMES/FRAME. The record comes last: a frame that has it is finished.
constexpr const char* kDatabaseName = "database.db";
constexpr const char* kRecordName = "triangulation.json";
constexpr const char* kUnfinishedName = ".unfinished";

struct InputFrame {
  std::string name;
  std::vector<FrameImageFile> files;
  std::vector<std::string> warnings;
  std::string failure;  // empty: none so far
};

struct Inputs {
  CameraNaming naming;
  std::vector<RigCamera> cameras;  // in the order of RIG
  std::vector<InputFrame> frames;
  std::vector<std::pair<size_t, size_t>> pairs;  // of cameras
  std::string fingerprint;  // of all that decides on the result but images
};

// COLMAP reports what it does on std::cout, from all threads at once. Silences
// it as long as this object lives; Print gets through.
class Progress {
 public:
  explicit Progress(bool quiet)
      : quiet_(quiet), stream_(std::cout.rdbuf()), buffer_(std::cout.rdbuf()) {
    std::cout.rdbuf(nullptr);
  }
  ~Progress() {
    std::cout.rdbuf(buffer_);
    std::cout.clear();
  }
  void Print(const std::string& line) {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!quiet_) stream_ << line << std::endl;
  }

 private:
  const bool quiet_;
  std::mutex mutex_;
  std::ostream stream_;
  std::streambuf* const buffer_;
};

std::string FindMask(const TriangulatorOptions& options,
                     const std::string& frame_name,
                     const std::string& image_name) {
  if (options.mask_path.empty()) return "";
  const fs::path masks = options.mask_path;
  for (const fs::path& path : {masks / frame_name / (image_name + ".png"),
                               masks / (image_name + ".png")}) {
    if (fs::is_regular_file(path)) return path.string();
  }
  return "";
}

// Image files in the frame's folder by camera of the rig.
InputFrame FindImages(const TriangulatorOptions& options,
                      const CameraNaming& naming,
                      const std::map<std::string, size_t>& camera_idxs,
                      const std::string& frame_name) {
  InputFrame frame;
  frame.name = frame_name;
  const fs::path folder = fs::path(options.image_path) / frame_name;
  std::vector<std::string> names;
  for (const auto& entry : fs::recursive_directory_iterator(folder)) {
    const bool is_image =
        FreeImage_GetFIFFromFilename(entry.path().c_str()) != FIF_UNKNOWN;
    if (is_image && entry.is_regular_file()) {
      names.push_back(entry.path().lexically_relative(folder).string());
    }
  }
  std::sort(names.begin(), names.end());
  const std::vector<std::string> camera_names = naming.Names(names);
  std::map<size_t, std::string> name_of_camera;
  for (size_t i = 0; i < names.size(); ++i) {
    const auto it = camera_idxs.find(camera_names[i]);
    if (it == camera_idxs.end()) {
      frame.warnings.push_back((folder / names[i]).string() +
                               ": no camera of the rig; left out");
      continue;
    }
    const auto inserted = name_of_camera.emplace(it->second, names[i]);
    if (!inserted.second) {
      frame.failure = "the images '" + inserted.first->second + "' and '" +
                      names[i] + "' belong to the same camera '" + it->first +
                      "'; set --MultiFrame.camera_name_regex";
    }
    frame.files.push_back({it->second,
                           names[i],
                           (folder / names[i]).string(),
                           FindMask(options, frame_name, names[i])});
  }
  return frame;
}

// Image size of a camera, from its first image that can be read. False if
// there is none.
bool FindImageSize(const std::vector<InputFrame>& frames,
                   size_t camera_idx,
                   RigCamera* camera) {
  for (const InputFrame& frame : frames) {
    for (const FrameImageFile& file : frame.files) {
      colmap::Bitmap bitmap;
      if (file.camera_idx == camera_idx &&
          bitmap.Read(file.path, /*as_rgb=*/false)) {
        camera->width = bitmap.Width();
        camera->height = bitmap.Height();
        return true;
      }
    }
  }
  return false;
}

// Sets the intrinsics to start from.
void SetIntrinsics(const TriangulatorOptions& options,
                   const KnownCamera* known,
                   RigCamera* camera) {
  if (options.focal_length_factor > 0.0) {
    colmap::Camera initial;
    initial.InitializeWithName(
        options.camera_model,
        options.focal_length_factor * std::max(camera->width, camera->height),
        camera->width,
        camera->height);
    camera->model = FindCameraModel(options.camera_model);
    camera->params = initial.Params();
  } else if (known != nullptr && known->model != nullptr) {
    camera->model = known->model;
    camera->params = known->params;
  } else {
    throw InputError(
        "Camera '" + camera->name + "' has no intrinsics in " +
        (options.intrinsics_path.empty() ? options.extrinsics_path
                                         : options.intrinsics_path) +
        ". Give a model with all cameras as --intrinsics_path, or set "
        "--MultiFrameTriangulator.focal_length_factor.");
  }
}

std::vector<RigCamera> MakeCameras(const TriangulatorOptions& options,
                                   const Rig& extrinsics,
                                   const Rig& intrinsics,
                                   const std::vector<InputFrame>& frames) {
  std::map<std::string, const KnownCamera*> known_cameras;
  for (const KnownCamera& camera : intrinsics.cameras) {
    known_cameras[camera.name] = &camera;
  }
  std::set<size_t> used;
  for (const InputFrame& frame : frames) {
    for (const FrameImageFile& file : frame.files) used.insert(file.camera_idx);
  }
  std::vector<RigCamera> cameras;
  for (size_t i = 0; i < extrinsics.cameras.size(); ++i) {
    const KnownCamera& source = extrinsics.cameras[i];
    const KnownCamera* known = known_cameras.count(source.name) > 0
                                   ? known_cameras.at(source.name)
                                   : nullptr;
    RigCamera camera;
    camera.name = source.name;
    camera.cam_from_world = source.cam_from_world;
    if (used.count(i) > 0) {
      if (known != nullptr) {
        camera.width = known->width;
        camera.height = known->height;
      }
      if (camera.width == 0 && !FindImageSize(frames, i, &camera)) {
        throw InputError("Camera '" + camera.name +
                         "': its size is not in RIG, and none of its images "
                         "can be read. Correct the images.");
      }
      SetIntrinsics(options, known, &camera);
    }
    cameras.push_back(std::move(camera));
  }
  return cameras;
}

// Pairs of cameras that have images.
std::vector<std::pair<size_t, size_t>> SelectPairs(
    const TriangulatorOptions& options, const std::vector<RigCamera>& cameras) {
  std::vector<RigCamera> used;
  std::vector<size_t> idxs;
  for (size_t i = 0; i < cameras.size(); ++i) {
    if (cameras[i].model == nullptr) continue;
    used.push_back(cameras[i]);
    idxs.push_back(i);
  }
  if (used.size() < 2) {
    throw InputError("Only " + std::to_string(used.size()) + " cameras of " +
                     options.extrinsics_path + " have images in " +
                     options.image_path +
                     ". Is it the RIG of this array? Images are looked for as "
                     "IMAGES/FRAME/IMAGE_NAME; otherwise set "
                     "--MultiFrame.camera_name_regex so that names agree.");
  }
  std::vector<std::pair<size_t, size_t>> pairs =
      SelectOverlappingPairs(options.view_overlap, used, options.num_threads);
  for (auto& [i, j] : pairs) {
    i = idxs[i];
    j = idxs[j];
  }
  return pairs;
}

// FNV-1a hash of the options and cameras that decide on the result.
std::string Fingerprint(const OptionParser& parser,
                        const std::vector<RigCamera>& cameras) {
  Json json = parser.ToJson();
  for (const char* name : {"output_path",
                           "frame_list_path",
                           "MultiFrameTriangulator.num_threads",
                           "MultiFrameTriangulator.overwrite",
                           "MultiFrameTriangulator.quiet",
                           "SiftExtraction.num_threads",
                           "SiftMatching.num_threads"}) {
    json.erase(name);
  }
  for (const RigCamera& camera : cameras) {
    const Rigid3& pose = camera.cam_from_world;
    const Eigen::Vector4d q = pose.rotation.coeffs();
    const Eigen::Vector3d& t = pose.translation;
    json["cameras"].push_back({camera.name,
                               {camera.width, camera.height},
                               camera.params,
                               {q(0), q(1), q(2), q(3)},
                               {t(0), t(1), t(2)}});
  }
  uint64_t hash = 14695981039346656037u;
  for (const char c :
       json.dump(-1, ' ', false, Json::error_handler_t::replace)) {
    hash = (hash ^ static_cast<unsigned char>(c)) * 1099511628211u;
  }
  return colmap::StringPrintf("%016zx", static_cast<size_t>(hash));
}

Inputs ReadInputs(const TriangulatorOptions& options,
                  const OptionParser& parser) {
  Inputs inputs{CameraNaming(options.camera_name_regex), {}, {}, {}, ""};
  const Rig extrinsics = ReadRig(options.extrinsics_path,
                                 options.extrinsics_format,
                                 inputs.naming,
                                 options.extrinsics_pixel_offset);
  const Rig intrinsics = options.intrinsics_path.empty()
                             ? extrinsics
                             : ReadRig(options.intrinsics_path,
                                       options.intrinsics_format,
                                       inputs.naming,
                                       options.intrinsics_pixel_offset);
  std::map<std::string, size_t> camera_idxs;
  for (size_t i = 0; i < extrinsics.cameras.size(); ++i) {
    camera_idxs[extrinsics.cameras[i].name] = i;
  }
  if (!options.mask_path.empty() && !fs::is_directory(options.mask_path)) {
    throw InputError("--mask_path " + options.mask_path + " is not a folder.");
  }
  for (const std::string& name :
       ListFrames("image_path", options.image_path, options.frame_list_path)) {
    inputs.frames.push_back(
        FindImages(options, inputs.naming, camera_idxs, name));
  }
  inputs.cameras = MakeCameras(options, extrinsics, intrinsics, inputs.frames);
  inputs.pairs = SelectPairs(options, inputs.cameras);
  inputs.fingerprint = Fingerprint(parser, inputs.cameras);
  return inputs;
}

// The record of an earlier run, empty if the frame is not finished.
Json ReadRecord(const fs::path& folder) {
  std::ifstream file(folder / kRecordName);
  if (!file || !fs::exists(folder / "sparse" / "0" / "points3D.bin")) {
    return Json::object();
  }
  const Json record = Json::parse(file, nullptr, /*allow_exceptions=*/false);
  return record.is_object() ? record : Json::object();
}

Json MakeRecord(const Inputs& inputs,
                bool made_database,
                const FrameStatistics& statistics,
                const FrameTimings& timings,
                const std::vector<std::string>& warnings) {
  return {{"inputs", inputs.fingerprint},
          {"database", made_database ? "made" : "given"},
          {"num_images", statistics.num_images},
          {"num_pairs", statistics.num_pairs},
          {"num_matches", statistics.num_matches},
          {"num_inlier_matches", statistics.num_inlier_matches},
          {"median_tolerance_px", statistics.median_tolerance},
          {"large_tolerance_px", statistics.large_tolerance},
          {"num_points", statistics.num_points},
          {"num_observations", statistics.num_observations},
          {"timings_s",
           {{"extraction", timings.extraction},
            {"matching", timings.matching},
            {"verification", timings.verification},
            {"triangulation", timings.triangulation}}},
          {"warnings", warnings}};
}

// Writes everything under a temporary name; the record is moved last.
class FrameOutput {
 public:
  explicit FrameOutput(const fs::path& folder)
      : folder_(folder), unfinished_(folder / kUnfinishedName) {
    Try([this]() {
      fs::remove_all(unfinished_);
      fs::create_directories(unfinished_ / "sparse" / "0");
    });
  }
  ~FrameOutput() {
    std::error_code ignored;
    fs::remove_all(unfinished_, ignored);
    fs::remove(folder_, ignored);  // only if nothing else is in it
  }

  std::string DatabasePath() const {
    return (unfinished_ / kDatabaseName).string();
  }

  void WriteModel(const colmap::Reconstruction& model) const {
    const fs::path path = unfinished_ / "sparse" / "0";
    model.WriteBinary(path.string());
    try {
      CheckBinaryModel({true,
                        (path / "cameras.bin").string(),
                        (path / "images.bin").string(),
                        (path / "points3D.bin").string()});
    } catch (const InputError& error) {
      throw OutputError("The model just written is not complete: " +
                        std::string(error.what()) + " Is the disk full?");
    }
  }

  void Finish(bool keep_database, const Json& record) const {
    Try([&]() {
      std::ofstream file(unfinished_ / kRecordName);
      file << record.dump(2, ' ', false, Json::error_handler_t::replace)
           << "\n";
      file.close();
      if (!file) throw std::runtime_error("is the disk full?");
      fs::remove(folder_ / kRecordName);
      if (keep_database) {
        fs::rename(DatabasePath(), folder_ / kDatabaseName);
      }
      fs::remove_all(folder_ / "sparse" / "0");
      fs::create_directories(folder_ / "sparse");
      fs::rename(unfinished_ / "sparse" / "0", folder_ / "sparse" / "0");
      fs::rename(unfinished_ / kRecordName, folder_ / kRecordName);
    });
  }

 private:
  template <typename Function>
  void Try(const Function& function) const {
    try {
      function();
    } catch (const std::exception& error) {
      throw OutputError(folder_.string() +
                        ": cannot write: " + std::string(error.what()));
    }
  }

  const fs::path folder_;
  const fs::path unfinished_;
};

// Returns what the frame came to, for the log. Throws InputError.
std::string ProcessFrame(const TriangulatorOptions& options,
                         const Inputs& inputs,
                         int num_threads,
                         InputFrame* frame) {
  const fs::path folder = fs::path(options.output_path) / frame->name;
  const Json previous = ReadRecord(folder);
  if (!options.overwrite &&
      previous.value("inputs", "") == inputs.fingerprint) {
    return "finished before";
  }
  const fs::path database_path = folder / kDatabaseName;
  const bool is_own = previous.value("database", "") == "made";
  const bool make_database =
      !fs::exists(database_path) || (options.overwrite && is_own);
  if (make_database && !frame->failure.empty()) {
    throw InputError(frame->failure);
  }
  const FrameOutput output(folder);
  FrameStatistics statistics;
  FrameTimings timings;
  if (make_database) {
    MakeFrameDatabase(options,
                      inputs.cameras,
                      frame->files,
                      inputs.pairs,
                      num_threads,
                      output.DatabasePath(),
                      &timings,
                      &frame->warnings);
  } else {
    CopyFrameDatabase(database_path.string(), output.DatabasePath());
  }
  const colmap::Reconstruction model = TriangulateFrame(options,
                                                        inputs.naming,
                                                        inputs.cameras,
                                                        num_threads,
                                                        output.DatabasePath(),
                                                        &statistics,
                                                        &timings,
                                                        &frame->warnings);
  output.WriteModel(model);
  output.Finish(make_database,
                MakeRecord(inputs,
                           make_database || is_own,
                           statistics,
                           timings,
                           frame->warnings));
  return colmap::StringPrintf(
      "%zu images, %zu pairs, tolerance %.1f px, %zu points, track length "
      "%.2f%s (%.1f + %.1f + %.1f + %.1f s)",
      statistics.num_images,
      statistics.num_pairs,
      statistics.median_tolerance,
      statistics.num_points,
      static_cast<double>(statistics.num_observations) / statistics.num_points,
      make_database ? "" : ", given database",
      timings.extraction,
      timings.matching,
      timings.verification,
      timings.triangulation);
}

void ProcessFrames(const TriangulatorOptions& options, Inputs* inputs) {
  const int num_threads = colmap::GetEffectiveNumThreads(options.num_threads);
  const int num_frames_at_once =
      std::min<int>(num_threads, inputs->frames.size());
  std::atomic<size_t> num_done = 0;
  Progress progress(options.quiet);
  ParallelFor(inputs->frames.size(), num_frames_at_once, [&](size_t i) {
    InputFrame& frame = inputs->frames[i];
    std::string outcome;
    try {
      outcome = ProcessFrame(
          options, *inputs, num_threads / num_frames_at_once, &frame);
      frame.failure.clear();
    } catch (const OutputError&) {
      throw;
    } catch (const std::exception& error) {
      frame.failure = error.what();
      outcome = "FAILED: " + frame.failure;
    }
    std::string lines = "Frame '" + frame.name + "' (" +
                        std::to_string(++num_done) + " / " +
                        std::to_string(inputs->frames.size()) + "): " + outcome;
    for (const std::string& warning : frame.warnings) {
      lines += "\n  WARNING: " + warning;
    }
    progress.Print(lines);
  });
}

void CreateOutputFolder(const std::string& path) {
  std::error_code error;
  fs::create_directories(path, error);
  if (error || !fs::is_directory(path)) {
    throw OutputError("--output_path " + path + ": cannot make the folder" +
                      (error ? ": " + error.message() : "") + ".");
  }
}

// What failed goes to stderr also when the progress is not shown.
void ReportFailures(const std::vector<InputFrame>& frames) {
  const InputFrame* first_failed = nullptr;
  size_t num_failed = 0;
  for (const InputFrame& frame : frames) {
    if (frame.failure.empty()) continue;
    if (first_failed == nullptr) first_failed = &frame;
    ++num_failed;
  }
  if (num_failed == frames.size()) {
    throw InputError("No frame could be triangulated. The first, '" +
                     first_failed->name + "': " + first_failed->failure);
  }
  for (const InputFrame& frame : frames) {
    if (!frame.failure.empty()) {
      std::cerr << "WARNING: frame '" << frame.name
                << "' is left out: " << frame.failure << std::endl;
    }
  }
}

// COLMAP's default asks for a GPU; without one it would end the program.
void ChooseDevice(TriangulatorOptions* options) {
  if (!HasGpuSift()) {
    options->sift_extraction.use_gpu = false;
    options->sift_matching.use_gpu = false;
  }
}

}  // namespace

int RunMultiFrameTriangulator(int argc, char** argv) {
  return RunCommand([argc, argv]() {
    TriangulatorOptions options;
    OptionParser parser;
    AddTriangulatorOptions(&options, &parser);
    parser.Parse(argc, argv);
    ChooseDevice(&options);
    options.Check();
    Inputs inputs = ReadInputs(options, parser);
    CreateOutputFolder(options.output_path);
    if (!options.quiet) {
      std::cout << inputs.frames.size() << " frames, " << inputs.pairs.size()
                << " pairs of cameras overlap" << std::endl;
    }
    ProcessFrames(options, &inputs);
    ReportFailures(inputs.frames);
  });
}

}  // namespace mfir
