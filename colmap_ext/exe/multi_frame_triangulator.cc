// The command multi_frame_triangulator: frames from images and known
// extrinsics.

#include <algorithm>
#include <atomic>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <map>
#include <memory>
#include <new>
#include <optional>
#include <thread>

#include <nlohmann/json.hpp>

#include "colmap_ext/controllers/frame_triangulation.h"
#include "colmap_ext/controllers/keypoint_refinement.h"
#include "colmap_ext/controllers/parallel_log.h"
#include "colmap_ext/controllers/stage_progress.h"
#include "colmap_ext/exe/command.h"
#include "colmap_ext/exe/triangulator_inputs.h"
#include "colmap_ext/frames/capture_videos.h"
#include "colmap_ext/frames/frame_database.h"
#include "colmap_ext/host/database.h"
#include "colmap_ext/host/util.h"
#include "colmap_ext/io/work_folder.h"
#include "colmap_ext/models/model_io.h"
#include "colmap_ext/options/triangulator_options.h"
#include "src/parallel/parallel_for.h"
#include "src/patches/track_refinement.h"
#include "src/util/errors.h"
#include "src/util/interruption.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

// Within FRAMES/FRAME. The record comes last: a frame that has it is finished.
constexpr const char* kDatabaseName = "database.db";
constexpr const char* kRecordName = "triangulation.json";
constexpr const char* kUnfinishedName = ".unfinished";

// The record of an earlier run, empty if the frame is not finished.
Json ReadRecord(const fs::path& folder) {
  std::ifstream file(folder / kRecordName);
  if (!file || !fs::exists(folder / "sparse" / "0" / "points3D.bin")) {
    return Json::object();
  }
  const Json record = Json::parse(file, nullptr, /*allow_exceptions=*/false);
  const auto is_text = [&record](const char* key) {
    return record.contains(key) && record[key].is_string();
  };
  return record.is_object() && is_text("inputs") && is_text("database")
             ? record
             : Json::object();
}

Json MakeRecord(const TriangulatorInputs& inputs,
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
            {"triangulation", timings.triangulation},
            {"keypoints", timings.keypoints}}},
          {"warnings", warnings}};
}

// Made where it is missing. A link could lead out of the output.
fs::path RealFolder(const fs::path& folder) {
  std::error_code error;
  if (fs::is_symlink(folder, error)) {
    throw OutputError(folder.string() +
                      " is a link, which is not followed. Replace it by a "
                      "folder, or give another --output_path.");
  }
  fs::create_directory(folder, error);
  if (error) {
    throw OutputError(folder.string() +
                      ": cannot make the folder: " + error.message() + ".");
  }
  return folder;
}

// Writes everything under a temporary name; the record is moved last.
class FrameOutput {
 public:
  explicit FrameOutput(const fs::path& folder) : folder_(RealFolder(folder)) {
    work_folder_.emplace(folder / kUnfinishedName);
  }
  ~FrameOutput() {
    work_folder_.reset();
    std::error_code ignored;
    fs::remove(folder_, ignored);  // only if nothing else is in it
  }

  std::string DatabasePath() const {
    return (work_folder_->Path() / kDatabaseName).string();
  }

  std::string ModelPath() const {
    return (work_folder_->Path() / "sparse" / "0").string();
  }

  void Finish(bool keep_database, const Json& record) const {
    Try([&]() {
      const fs::path& work = work_folder_->Path();
      Write(work / "begun", "{}");
      Write(work / kRecordName,
            record.dump(2, ' ', false, Json::error_handler_t::replace));
      const fs::path model = RealFolder(folder_ / "sparse") / "0";
      const SignalDelay delay;
      // A model beside a record is one of this command's, finished or not.
      fs::rename(work / "begun", folder_ / kRecordName);
      if (keep_database) {
        fs::rename(DatabasePath(), folder_ / kDatabaseName);
      }
      fs::remove_all(model);
      fs::rename(work / "sparse" / "0", model);
      fs::rename(work / kRecordName, folder_ / kRecordName);
    });
  }

 private:
  static void Write(const fs::path& path, const std::string& text) {
    std::ofstream file(path);
    file << text << "\n";
    file.close();
    if (!file) throw std::runtime_error("is the disk full?");
  }

  template <typename Function>
  void Try(const Function& function) const {
    try {
      function();
    } catch (const OutputError&) {
      throw;
    } catch (const std::exception& error) {
      throw OutputError(folder_.string() +
                        ": cannot write: " + std::string(error.what()));
    }
  }

  const fs::path folder_;
  // Goes before the folder that it is in.
  std::optional<WorkFolder> work_folder_;
};

// Waits while another run makes the frame, and then has *waited true.
std::unique_ptr<FrameOutput> LockFrame(const fs::path& folder,
                                       const std::string& name,
                                       ParallelLog* log,
                                       bool* waited) {
  *waited = false;
  while (true) {
    try {
      return std::make_unique<FrameOutput>(folder);
    } catch (const FolderInUse&) {
      if (!*waited) {
        log->Print("Frame '" + name + "': another run is making it; waiting");
      }
      *waited = true;
      std::this_thread::sleep_for(std::chrono::milliseconds(100));
    }
  }
}

host::Reconstruction RefineKeypoints(const TriangulatorOptions& options,
                                     const TriangulatorInputs& inputs,
                                     int num_threads,
                                     const InputFrame& frame,
                                     host::Reconstruction model,
                                     ParallelLog* log,
                                     FrameStatistics* statistics,
                                     FrameTimings* timings) {
  if (!options.refine_keypoints && !options.complete_tracks) return model;
  host::Timer timer;
  timer.Start();
  TrackRefinementOptions track_options;
  track_options.refine_keypoints = options.refine_keypoints;
  track_options.complete_tracks = options.complete_tracks;
  track_options.num_threads = num_threads;
  std::map<size_t, std::string> image_paths;
  for (const FrameImageFile& file : frame.files) {
    image_paths[file.camera_idx] = file.path;
  }
  std::string line;
  model = RefineKeypointsOfModel(track_options,
                                 inputs.cameras,
                                 image_paths,
                                 frame.name,
                                 std::move(model),
                                 &line);
  log->Print(line);
  statistics->num_points = model.NumPoints3D();
  statistics->num_observations = model.ComputeNumObservations();
  timings->keypoints = timer.ElapsedSeconds();
  return model;
}

// Returns what the frame came to, for the log. Throws InputError.
std::string ProcessFrame(const TriangulatorOptions& options,
                         const TriangulatorInputs& inputs,
                         int num_threads,
                         ParallelLog* log,
                         InputFrame* frame) {
  const fs::path folder = fs::path(options.output_path) / frame->name;
  const auto is_finished = [&inputs](const Json& record) {
    return record.value("inputs", "") == inputs.fingerprint;
  };
  const Json previous = ReadRecord(folder);
  if (!options.overwrite && is_finished(previous)) return "finished before";
  if (fs::exists(folder / "sparse" / "0") &&
      !fs::exists(folder / kRecordName)) {
    throw InputError((folder / "sparse" / "0").string() +
                     " is there, but not from this command: it is not "
                     "replaced. Move it away, or give another --output_path.");
  }
  const fs::path database_path = folder / kDatabaseName;
  const bool is_own = previous.value("database", "") == "made";
  const bool make_database =
      !fs::exists(database_path) || (options.overwrite && is_own);
  if (make_database && !frame->failure.empty()) {
    throw InputError(frame->failure);
  }
  bool waited = false;
  const std::unique_ptr<FrameOutput> output =
      LockFrame(folder, frame->name, log, &waited);
  if (waited) {
    const Json record = ReadRecord(folder);
    if (is_finished(record)) return "finished by another run";
    if (record != previous) {
      throw OutputError(folder.string() +
                        ": another run, with other inputs or options, has "
                        "made this frame meanwhile. Give each an "
                        "--output_path of its own.");
    }
  }
  FrameStatistics statistics;
  FrameTimings timings;
  if (make_database) {
    MakeFrameDatabase(options,
                      inputs.cameras,
                      frame->files,
                      inputs.pairs,
                      num_threads,
                      output->DatabasePath(),
                      LogProgress(frame->name, "images", log),
                      &timings,
                      &frame->warnings);
  } else {
    CopyFrameDatabase(database_path.string(), output->DatabasePath());
  }
  {
    const std::shared_ptr<host::Database> database =
        host::OpenDatabase(output->DatabasePath());
    host::Reconstruction model =
        TriangulateFrame(options,
                         inputs.naming.OfFrame(frame->name),
                         inputs.cameras,
                         inputs.pairs,
                         num_threads,
                         LogProgress(frame->name, "pairs", log),
                         database.get(),
                         &statistics,
                         &timings,
                         &frame->warnings);
    WriteModel(output->ModelPath(),
               /*with_text=*/false,
               RefineKeypoints(options,
                               inputs,
                               num_threads,
                               *frame,
                               std::move(model),
                               log,
                               &statistics,
                               &timings));
  }
  output->Finish(make_database,
                 MakeRecord(inputs,
                            make_database || is_own,
                            statistics,
                            timings,
                            frame->warnings));
  return host::StringPrintf(
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

void ProcessFrames(const TriangulatorOptions& options,
                   TriangulatorInputs* inputs) {
  const int num_threads =
      options.num_threads > 0 ? options.num_threads : NumThreadsOfMachine();
  const int num_frames_at_once =
      std::min<int>(num_threads, inputs->frames.size());
  std::atomic<size_t> num_done = 0;
  ParallelLog log(options.quiet);
  ParallelFor(inputs->frames.size(), num_frames_at_once, [&](size_t i) {
    InputFrame& frame = inputs->frames[i];
    std::string outcome;
    try {
      outcome = ProcessFrame(
          options, *inputs, num_threads / num_frames_at_once, &log, &frame);
      frame.failure.clear();
    } catch (const OutputError&) {
      throw;
    } catch (const std::bad_alloc&) {
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
    log.Print(lines);
  });
}

// Every n-th: frames that an earlier run has finished lie together, and so the
// rest is shared out evenly.
std::vector<InputFrame> FramesOfRank(const Communicator& ranks,
                                     std::vector<InputFrame> frames) {
  std::vector<InputFrame> own;
  for (size_t i = ranks.Rank(); i < frames.size(); i += ranks.NumRanks()) {
    own.push_back(std::move(frames[i]));
  }
  return own;
}

void CreateOutputFolder(const std::string& path) {
  std::error_code error;
  fs::create_directories(path, error);
  if (error || !fs::is_directory(path)) {
    throw OutputError("--output_path " + path + ": cannot make the folder" +
                      (error ? ": " + error.message() : "") + ".");
  }
}

// What max_num_frames has chosen, for --frame_list_path. Frames of an earlier
// run may lie beside them.
void WriteFrameList(const TriangulatorOptions& options,
                    const Communicator& ranks,
                    const std::vector<InputFrame>& frames) {
  std::vector<std::string> names;
  for (const InputFrame& frame : frames) {
    if (frame.failure.empty()) names.push_back(frame.name);
  }
  names = Concatenate(ranks, names);
  if (!ranks.IsFirst()) return;
  const fs::path path = fs::path(options.output_path) / kFrameListName;
  if (options.max_num_frames == 0) {
    std::error_code ignored;
    fs::remove(path, ignored);
    return;
  }
  std::ofstream file(path);
  for (const std::string& name : names) file << name << "\n";
  file.close();
  if (!file) {
    throw OutputError(path.string() + ": cannot write. Is the disk full?");
  }
}

// What failed goes to stderr also when the progress is not shown.
void ReportFailures(const Communicator& ranks,
                    const std::vector<InputFrame>& frames) {
  std::vector<std::string> names;
  std::vector<std::string> failures;
  for (const InputFrame& frame : frames) {
    if (frame.failure.empty()) continue;
    names.push_back(frame.name);
    failures.push_back(frame.failure);
  }
  names = Concatenate(ranks, names);
  failures = Concatenate(ranks, failures);
  if (names.size() == Sum(ranks, frames.size())) {
    throw InputError("No frame could be triangulated. The first, '" +
                     names.front() + "': " + failures.front());
  }
  for (size_t i = 0; ranks.IsFirst() && i < names.size(); ++i) {
    std::cerr << "WARNING: frame '" << names[i]
              << "' is left out: " << failures[i] << std::endl;
  }
}

}  // namespace

int RunMultiFrameTriangulator(int argc, char** argv) {
  return RunCommandOverRanks([argc, argv](const Communicator& ranks) {
    TriangulatorOptions options;
    OptionParser parser;
    parser.SetHelp(
        "Makes a sparse model of every frame from its images and the known "
        "extrinsics, without structure\nfrom motion.",
        "colmap multi_frame_triangulator --image_path IMAGES "
        "--extrinsics_path RIG --output_path FRAMES");
    AddTriangulatorOptions(&options, &parser);
    parser.Parse(argc, argv);
    ChooseFeatures(parser, &options);
    options.Check();
    LimitThreads(options.num_threads);
    if (!ranks.IsAlone() && HasVideosOnly(options.image_path)) {
      throw UsageError(
          "Several processes cannot decode videos together: run one process.");
    }
    TriangulatorInputs inputs = ReadTriangulatorInputs(options, parser);
    CreateOutputFolder(options.output_path);
    if (!options.quiet && ranks.IsFirst()) {
      std::cout << inputs.frames.size() << " frames, " << inputs.pairs.size()
                << " pairs of cameras overlap" << std::endl;
    }
    inputs.frames = FramesOfRank(ranks, std::move(inputs.frames));
    ProcessFrames(options, &inputs);
    WriteFrameList(options, ranks, inputs.frames);
    ReportFailures(ranks, inputs.frames);
  });
}

}  // namespace mfir
