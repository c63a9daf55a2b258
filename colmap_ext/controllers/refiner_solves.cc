#include "colmap_ext/controllers/refiner_solves.h"

#include <algorithm>
#include <limits>

#include "colmap_ext/controllers/frame_retriangulation.h"
#include "colmap_ext/controllers/multi_frame_bundle_adjuster.h"
#include "src/evaluation/extrinsics_check.h"
#include "src/refinement/held_out_tracks.h"
#include "src/refinement/static_points.h"

namespace mfir {
namespace {

// Share by which the tolerance has to fall, or the observations to grow.
constexpr double kMinImprovement = 0.01;

// The paper's schedule over COLMAP's bundle adjustment problem; leaves points,
// per-frame intrinsics and global intrinsics in the scene.
void RunSchedule(const MultiFrameOptions& options,
                 const Similarity3& normalized_from_rig,
                 const StageCallback& callback,
                 Capture* capture,
                 Scene* scene) {
  MultiFrameOptions schedule_options = options;
  if (options.loss_scale == 0.0) {
    schedule_options.loss_scale = EstimateCauchyScale(*scene);
  }
  MultiFrameBundleAdjuster(schedule_options).Run(callback, capture, scene);
  const std::vector<RigCamera> cameras = std::move(scene->cameras);
  const std::vector<Frame> frames = std::move(scene->frames);
  *scene = BuildScene(normalized_from_rig, *capture);
  for (size_t i = 0; i < frames.size(); ++i) {
    // The same tracks in the same order.
    Frame& frame = scene->frames[i];
    frame.cost_maps = frames[i].cost_maps;
    frame.feature_keypoints = frames[i].feature_keypoints;
    for (size_t k = 0; k < frame.observations.size(); ++k) {
      frame.observations[k].cost_map_idx =
          frames[i].observations[k].cost_map_idx;
    }
  }
  if (options.SingleFrameMode()) {
    InitializeIntrinsics(options, scene);
  } else {
    scene->cameras = cameras;
  }
}

bool HasDatabases(const Capture& capture) {
  return std::any_of(
      capture.frames.begin(), capture.frames.end(), [](const auto& frame) {
        return frame.skip_reason.empty() && !frame.database_path.empty();
      });
}

void CountTracks(const Scene& scene,
                 size_t* num_points,
                 size_t* num_observations) {
  for (const Frame& frame : scene.frames) {
    *num_points += frame.points.size();
    *num_observations += frame.observations.size();
  }
}

void LogRetriangulation(const Retriangulation& tracks,
                        const Scene& scene,
                        const std::string& round,
                        const Progress& progress) {
  size_t num_points_before = 0;
  size_t num_observations_before = 0;
  CountTracks(scene, &num_points_before, &num_observations_before);
  progress.Log(colmap::StringPrintf(
      "Round %s: new tracks in %zu of %zu frames, %zu points (before %zu), "
      "track length %.2f (%.2f), tolerance %.1f px",
      round.c_str(),
      tracks.num_frames,
      scene.frames.size(),
      tracks.num_points,
      num_points_before,
      static_cast<double>(tracks.num_observations) / tracks.num_points,
      static_cast<double>(num_observations_before) / num_points_before,
      tracks.tolerance_px));
}

// Each is tried, and reported, once.
void LeaveUnusableDatabases(const std::vector<std::string>& failures,
                            const Progress& progress,
                            Capture* capture) {
  size_t i = 0;
  for (FrameModel& frame : capture->frames) {
    if (!frame.skip_reason.empty()) continue;
    const std::string& failure = failures[i++];
    if (failure.empty()) continue;
    progress.Log("Frame '" + frame.name +
                 "' keeps its tracks: " + frame.database_path + ": " + failure);
    frame.database_path.clear();
  }
}

}  // namespace

StartResiduals EvaluateStart(const MultiFrameOptions& options,
                             const Scene& start) {
  return {RobustStdByCamera(start,
                            SquaredResiduals(start, options.SingleFrameMode())),
          RobustStdByCamera(start, OwnSquaredResiduals(start))};
}

std::vector<ExtrinsicsContradiction> AddContradictions(
    const Scene& scene,
    const StartResiduals& start,
    const std::vector<double>& stds_px,
    Capture* capture) {
  const std::vector<ExtrinsicsContradiction> contradictions =
      FindExtrinsicsContradictions(start.stds_px, stds_px, start.own_stds_px);
  for (const ExtrinsicsContradiction& contradiction : contradictions) {
    const std::string& name = scene.cameras[contradiction.camera_idx].name;
    capture->contradicting_cameras.emplace(
        name,
        colmap::StringPrintf(
            "its residuals are %.2f px, the median camera's %.2f px, its own "
            "in the frames %.2f px",
            contradiction.std_px,
            contradiction.others_std_px,
            contradiction.own_std_px));
  }
  return contradictions;
}

RefinementResult RefineScene(const MultiFrameOptions& options,
                             const Similarity3& normalized_from_rig,
                             const StageCallback& callback,
                             Capture* capture,
                             Scene* scene) {
  const bool has_schedule = options.NumScheduleSolves() > 0;
  if (has_schedule) {
    RunSchedule(options, normalized_from_rig, callback, capture, scene);
  }
  MultiFrameOptions final_options = options;
  if (!options.progressive) {
    // The intrinsics stay what the soft prior gave; only the points follow the
    // known extrinsics.
    final_options.refine_focal_length = false;
    final_options.refine_principal_point = false;
    final_options.refine_extra_params = false;
  }
  // The scene has its own unit.
  final_options.extrinsics_translation_std *= normalized_from_rig.scale;
  return RefineFixedExtrinsics(final_options, !has_schedule, callback, scene);
}

RoundsResult RetriangulateInRounds(const MultiFrameOptions& options,
                                   const TriangulatorOptions& track_options,
                                   const Similarity3& normalized_from_rig,
                                   const std::filesystem::path& work_path,
                                   const StartResiduals& start,
                                   Progress* progress,
                                   std::vector<Stage>* stages,
                                   Capture* capture,
                                   Scene* scene) {
  RoundsResult result;
  const int num_rounds = options.retriangulation_rounds;
  double tolerance_px = std::numeric_limits<double>::infinity();
  for (int round = 1; round <= num_rounds && HasDatabases(*capture); ++round) {
    progress->Heading("Refining intrinsics");
    const StaticPoints static_points(options.static_points, scene);
    const HeldOutTracks held_out(options.held_out_share, scene);
    result.refinement = RefineScene(options,
                                    normalized_from_rig,
                                    progress->RecordStages(stages),
                                    capture,
                                    scene);
    AddContradictions(
        *scene,
        start,
        RobustStdByCamera(*scene,
                          SquaredResiduals(*scene, options.SingleFrameMode())),
        capture);
    held_out.PutBack(scene);
    static_points.PutBack(scene);
    progress->Heading("Retriangulating frames");
    Retriangulation tracks = RetriangulateFrames(
        options, track_options, work_path, *capture, *scene);
    LeaveUnusableDatabases(tracks.failures, *progress, capture);
    LogRetriangulation(
        tracks,
        *scene,
        std::to_string(round) + " / " + std::to_string(num_rounds),
        *progress);
    size_t num_points = 0;
    size_t num_observations = 0;
    CountTracks(*scene, &num_points, &num_observations);
    const bool is_better =
        tracks.tolerance_px < (1.0 - kMinImprovement) * tolerance_px ||
        tracks.num_observations > (1.0 + kMinImprovement) * num_observations;
    if (tracks.num_frames == 0 || !is_better) {
      progress->Log("No improvement: the tracks stay as they were");
      break;
    }
    tolerance_px = tracks.tolerance_px;
    ReplaceTracks(normalized_from_rig, std::move(tracks), capture, scene);
    result.has_new_tracks = true;
    result.refinement.reset();
  }
  return result;
}

Scene WithIntrinsics(const std::vector<std::vector<double>>& params,
                     const Scene& scene) {
  Scene changed = scene;
  for (size_t i = 0; i < params.size(); ++i) {
    changed.cameras[i].params = params[i];
  }
  for (Frame& frame : changed.frames) {
    for (FrameImage& image : frame.images) {
      image.params = params[image.camera_idx];
    }
  }
  return changed;
}

}  // namespace mfir
