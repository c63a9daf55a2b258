#include "colmap_ext/controllers/frame_retriangulation.h"

#include <algorithm>
#include <atomic>
#include <cmath>

#include "colmap_ext/controllers/frame_triangulation.h"
#include "colmap_ext/controllers/parallel_log.h"
#include "colmap_ext/host/database.h"
#include "colmap_ext/host/util.h"
#include "src/parallel/parallel_for.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

// Databases hold single precision.
constexpr double kMaxKeypointDifference = 0.01;  // px
constexpr double kMinShareOfObservations = 0.5;

// A folder for as long as this object lives.
class WorkFolder {
 public:
  explicit WorkFolder(const fs::path& path) : path_(path) {
    std::error_code error;
    fs::create_directories(path_, error);
    if (error) {
      throw OutputError("--output_path: cannot create " + path_.string() +
                        ": " + error.message() + ".");
    }
  }
  ~WorkFolder() {
    std::error_code ignored;
    fs::remove_all(path_, ignored);
  }
  WorkFolder(const WorkFolder&) = delete;
  WorkFolder& operator=(const WorkFolder&) = delete;

 private:
  const fs::path path_;
};

struct NewFrame {
  std::unique_ptr<host::Reconstruction> model;  // null: keeps its tracks
  FrameStatistics statistics;
  std::string failure;
};

// Also models of undistorted images or of refined keypoints may lie beside the
// database of the raw ones.
void CheckKeypoints(const FrameModel& frame, const host::Database& database) {
  for (const auto& [camera_idx, image_id] : frame.image_ids) {
    const host::Image& image = frame.reconstruction->Image(image_id);
    if (!database.ExistsImageWithName(image.Name())) {
      throw InputError("it has no image '" + image.Name() + "'");
    }
    const host::FeatureKeypoints keypoints = database.ReadKeypoints(
        host::ReadImageWithName(database, image.Name()).ImageId());
    for (size_t i = 0; i < image.NumPoints2D(); ++i) {
      const host::Point2D& point = image.Point2D(i);
      if (!point.HasPoint3D()) continue;
      const Eigen::Vector2d& xy = host::Xy(point);
      if (i >= keypoints.size() ||
          !(std::hypot(keypoints[i].x - xy.x(), keypoints[i].y - xy.y()) <=
            kMaxKeypointDifference)) {
        throw InputError("its keypoints of image '" + image.Name() +
                         "' are not those of the sparse model");
      }
    }
  }
}

// Leaves matches only; what came verified only becomes matches.
void ForgetVerification(host::Database* database) {
  const host::DatabaseTransaction transaction(database);
  if (database->NumMatches() == 0) {
    const auto matches_of_pairs = host::ReadInlierMatches(*database);
    database->ClearMatches();
    for (const auto& [pair_id, matches] : matches_of_pairs) {
      const auto [id1, id2] = host::PairIdToImagePair(pair_id);
      database->WriteMatches(id1, id2, matches);
    }
  }
  database->ClearTwoViewGeometries();
}

// Throws InputError where the frame must keep its tracks.
void Retriangulate(const MultiFrameOptions& options,
                   const TriangulatorOptions& track_options,
                   const std::vector<RigCamera>& cameras,
                   const fs::path& work_path,
                   int num_threads,
                   const FrameModel& frame,
                   NewFrame* result) {
  const WorkFolder folder(work_path);
  const std::string path = (work_path / "database.db").string();
  CopyFrameDatabase(frame.database_path, path);
  const std::shared_ptr<host::Database> database = host::OpenDatabase(path);
  CheckKeypoints(frame, *database);
  ForgetVerification(database.get());
  FrameTimings timings;
  // Images without camera in RIG have been reported before.
  std::vector<std::string> warnings;
  auto model = std::make_unique<host::Reconstruction>(TriangulateFrame(
      track_options,
      CameraNaming(options.camera_name_regex).OfFrame(frame.name),
      cameras,
      /*pairs=*/{},
      num_threads,
      /*progress=*/{},
      database.get(),
      &result->statistics,
      &timings,
      &warnings));
  const std::map<size_t, host::image_t> image_ids = ImageIdsByCamera(*model);
  for (const auto& [camera_idx, image_id] : frame.image_ids) {
    const std::string& name = frame.reconstruction->Image(image_id).Name();
    const auto it = image_ids.find(camera_idx);
    if (it == image_ids.end() || model->Image(it->second).Name() != name) {
      throw InputError("its image '" + name + "' belongs to another camera");
    }
  }
  const size_t num_before = frame.reconstruction->ComputeNumObservations();
  if (static_cast<double>(result->statistics.num_observations) <
      kMinShareOfObservations * static_cast<double>(num_before)) {
    throw InputError(
        "it gives only " + std::to_string(result->statistics.num_observations) +
        " observations in the stead of " + std::to_string(num_before));
  }
  result->model = std::move(model);
}

// By used frame.
std::vector<NewFrame> RetriangulateAll(
    const MultiFrameOptions& options,
    const TriangulatorOptions& track_options,
    const fs::path& work_path,
    const std::vector<const FrameModel*>& models,
    const Scene& scene,
    const Estimate& estimate) {
  const int num_threads = options.EffectiveNumThreads();
  const int num_frames_at_once =
      std::min<int>(num_threads, static_cast<int>(models.size()));
  std::vector<NewFrame> results(models.size());
  std::atomic<size_t> num_done = 0;
  ParallelLog log(options.quiet);
  ParallelFor(models.size(), num_frames_at_once, [&](size_t i) {
    NewFrame& result = results[i];
    ++num_done;
    if (models[i]->database_path.empty()) return;
    try {
      Retriangulate(options,
                    track_options,
                    options.SingleFrameMode() ? FrameCameras(scene, estimate, i)
                                              : estimate.cameras,
                    // Ranks share the path. Names of frames may be too long.
                    work_path / ("retriangulation_" +
                                 std::to_string(scene.ranks->Rank()) + "_" +
                                 std::to_string(i)),
                    num_threads / num_frames_at_once,
                    *models[i],
                    &result);
    } catch (const InputError& error) {
      result.failure = error.what();
      return;
    }
    log.Print(host::StringPrintf(
        "Frame '%s' (%zu / %zu): %zu points, track length %.2f, tolerance "
        "%.1f px",
        models[i]->name.c_str(),
        num_done.load(),
        models.size(),
        result.statistics.num_points,
        static_cast<double>(result.statistics.num_observations) /
            static_cast<double>(result.statistics.num_points),
        result.statistics.median_tolerance));
  });
  return results;
}

}  // namespace

Retriangulation RetriangulateFrames(const MultiFrameOptions& options,
                                    const TriangulatorOptions& track_options,
                                    const fs::path& work_path,
                                    const Capture& capture,
                                    const Scene& scene,
                                    const Estimate& estimate) {
  std::vector<NewFrame> new_frames = RetriangulateAll(
      options, track_options, work_path, capture.UsedFrames(), scene, estimate);
  Retriangulation result;
  std::vector<double> tolerances;
  for (size_t i = 0; i < new_frames.size(); ++i) {
    NewFrame& frame = new_frames[i];
    if (frame.model != nullptr) {
      tolerances.push_back(frame.statistics.median_tolerance);
      result.num_points += frame.statistics.num_points;
      result.num_observations += frame.statistics.num_observations;
    } else {
      result.num_points += scene.frames[i].NumPoints();
      result.num_observations += scene.frames[i].observations.size();
    }
    result.models.push_back(std::move(frame.model));
    result.failures.push_back(frame.failure);
  }
  tolerances = Concatenate(*scene.ranks, tolerances);
  result.num_frames = tolerances.size();
  result.num_points = Sum(*scene.ranks, result.num_points);
  result.num_observations = Sum(*scene.ranks, result.num_observations);
  result.tolerance_px = Quantile(tolerances, 0.5);
  return result;
}

Capture ReplaceModels(Retriangulation retriangulation, Capture capture) {
  size_t i = 0;
  for (FrameModel& frame : capture.frames) {
    if (!frame.skip_reason.empty()) continue;
    std::unique_ptr<host::Reconstruction>& model = retriangulation.models[i++];
    if (model == nullptr) continue;
    frame.image_ids = ImageIdsByCamera(*model);
    frame.reconstruction = std::move(model);
  }
  return capture;
}

SceneEstimate WithNewTracks(const Capture& capture,
                            const std::vector<bool>& is_new,
                            SceneEstimate previous) {
  SceneEstimate result = BuildScene(capture);
  result.scene.cameras = std::move(previous.scene.cameras);
  result.estimate.cameras = std::move(previous.estimate.cameras);
  for (size_t i = 0; i < is_new.size(); ++i) {
    if (is_new[i]) continue;
    result.scene.frames[i] = std::move(previous.scene.frames[i]);
    result.estimate.frames[i] = std::move(previous.estimate.frames[i]);
  }
  return result;
}

}  // namespace mfir
