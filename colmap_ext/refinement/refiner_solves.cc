#include "colmap_ext/refinement/refiner_solves.h"

#include <algorithm>
#include <limits>
#include <utility>

#include "colmap_ext/controllers/frame_retriangulation.h"
#include "colmap_ext/host/util.h"
#include "colmap_ext/refinement/multi_frame_bundle_adjuster.h"
#include "colmap_ext/refinement/scene_features.h"
#include "src/evaluation/extrinsics_check.h"
#include "src/scene/residual_statistics.h"
#include "src/selection/held_out_tracks.h"

namespace mfir {
namespace {

// Share by which the tolerance has to fall, or the observations to grow.
constexpr double kMinImprovement = 0.01;

// The paper's schedule over COLMAP's bundle adjustment problem.
Estimate RunSchedule(const MultiFrameOptions& options,
                     const StageCallback& callback,
                     const Capture& capture,
                     const Scene& scene,
                     Estimate start) {
  MultiFrameOptions schedule_options = options;
  if (options.loss_scale == 0.0) {
    schedule_options.loss_scale = EstimateCauchyScale(scene, start);
  }
  return MultiFrameBundleAdjuster(schedule_options)
      .Run(callback, capture, scene, std::move(start));
}

// Any rank.
bool HasDatabases(const Capture& capture) {
  return Any(
      *capture.ranks,
      std::any_of(
          capture.frames.begin(), capture.frames.end(), [](const auto& frame) {
            return frame.skip_reason.empty() && !frame.database_path.empty();
          }));
}

// Of all ranks.
void CountTracks(const Scene& scene,
                 size_t* num_points,
                 size_t* num_observations) {
  for (const Frame& frame : scene.frames) {
    *num_points += frame.NumPoints();
    *num_observations += frame.observations.size();
  }
  *num_points = Sum(*scene.ranks, *num_points);
  *num_observations = Sum(*scene.ranks, *num_observations);
}

void LogRetriangulation(const Retriangulation& tracks,
                        const Scene& scene,
                        const std::string& round,
                        size_t num_points_before,
                        size_t num_observations_before,
                        const Progress& progress) {
  progress.Log(host::StringPrintf(
      "Round %s: new tracks in %zu of %zu frames, %zu points (before %zu), "
      "track length %.2f (%.2f), tolerance %.1f px",
      round.c_str(),
      tracks.num_frames,
      Sum(*scene.ranks, scene.frames.size()),
      tracks.num_points,
      num_points_before,
      static_cast<double>(tracks.num_observations) / tracks.num_points,
      static_cast<double>(num_observations_before) / num_points_before,
      tracks.tolerance_px));
}

// Each is tried, and reported, once.
Capture LeaveUnusableDatabases(const std::vector<std::string>& failures,
                               const Progress& progress,
                               Capture capture) {
  size_t i = 0;
  for (FrameModel& frame : capture.frames) {
    if (!frame.skip_reason.empty()) continue;
    const std::string& failure = failures[i++];
    if (failure.empty()) continue;
    progress.Log("Frame '" + frame.name +
                 "' keeps its tracks: " + frame.database_path + ": " + failure);
    frame.database_path.clear();
  }
  return capture;
}

// Solves the selected tracks and leaves the points of the others where they
// are.
Tracks RefineRound(const MultiFrameOptions& options,
                   const Start& start,
                   Tracks tracks,
                   Progress* progress) {
  progress->Heading("Refining intrinsics");
  const Selection selection = SelectTracks(options, tracks.scene).selection;
  SceneEstimate fitted = SelectTracks(
      selection, TrackRole::kFitted, tracks.scene, tracks.estimate);
  tracks.refinement = RefineScene(options,
                                  progress->RecordStages(),
                                  tracks.capture,
                                  fitted.scene,
                                  std::move(fitted.estimate));
  const std::vector<double> stds_px =
      RobustStdByCamera(fitted.scene,
                        SquaredResiduals(fitted.scene,
                                         tracks.refinement->estimate,
                                         options.SingleFrameMode()));
  tracks.contradictions.merge(DescribeContradictions(
      tracks.scene,
      FindExtrinsicsContradictions(start.stds_px, stds_px, start.own_stds_px)));
  tracks.estimate = JoinEstimates(selection,
                                  TrackRole::kFitted,
                                  tracks.refinement->estimate,
                                  std::move(tracks.estimate));
  return tracks;
}

// The tracks of the capture's new models.
Tracks ReplaceTracks(Retriangulation retriangulation, Tracks tracks) {
  std::vector<bool> is_new;
  for (const auto& model : retriangulation.models) {
    is_new.push_back(model != nullptr);
  }
  tracks.capture =
      ReplaceModels(std::move(retriangulation), std::move(tracks.capture));
  SceneEstimate replaced =
      WithNewTracks(tracks.capture,
                    is_new,
                    {std::move(tracks.scene), std::move(tracks.estimate)});
  tracks.scene = std::move(replaced.scene);
  tracks.estimate = std::move(replaced.estimate);
  tracks.are_new = true;
  tracks.refinement.reset();
  return tracks;
}

// The tracks of a role, intersected with the cameras of the refined estimate.
SceneEstimate FitTracks(const MultiFrameOptions& options,
                        const Tracks& tracks,
                        const Selection& selection,
                        TrackRole role,
                        const Estimate& refined) {
  SceneEstimate fitted =
      SelectTracks(selection, role, tracks.scene, tracks.estimate);
  fitted.estimate.cameras = refined.cameras;
  bool is_empty = true;
  for (size_t f = 0; f < fitted.scene.frames.size(); ++f) {
    fitted.estimate.frames[f].images = refined.frames[f].images;
    is_empty = is_empty && fitted.scene.frames[f].NumPoints() == 0;
  }
  if (!Any(*tracks.scene.ranks, !is_empty)) return fitted;
  fitted.estimate =
      FitPoints(options, fitted.scene, std::move(fitted.estimate));
  return fitted;
}

// By any rank.
std::vector<bool> ObservedCameras(const Scene& scene) {
  std::vector<bool> observed(scene.cameras.size(), false);
  for (const Frame& frame : scene.frames) {
    for (const Observation& observation : frame.observations) {
      observed[frame.images[observation.image_idx].camera_idx] = true;
    }
  }
  return Any(*scene.ranks, observed);
}

}  // namespace

Start EvaluateStart(const MultiFrameOptions& options, SceneEstimate start) {
  const Scene& scene = start.scene;
  std::vector<double> stds_px = RobustStdByCamera(
      scene,
      SquaredResiduals(scene, start.estimate, options.SingleFrameMode()));
  std::vector<double> own_stds_px = RobustStdByCamera(
      scene,
      OwnSquaredResiduals(
          scene, start.estimate, options.EffectiveNumThreads()));
  return {std::move(start.scene),
          std::move(start.estimate),
          std::move(stds_px),
          std::move(own_stds_px)};
}

Contradictions DescribeContradictions(
    const Scene& scene,
    const std::vector<ExtrinsicsContradiction>& contradictions) {
  const std::vector<size_t> num_observations = NumObservationsByCamera(scene);
  Contradictions described;
  for (const ExtrinsicsContradiction& contradiction : contradictions) {
    if (num_observations[contradiction.camera_idx] < kMinJudgedObservations) {
      continue;
    }
    described[scene.cameras[contradiction.camera_idx].name] =
        host::StringPrintf(
            "its residuals are %.2f px, the median camera's %.2f px, its own "
            "in the frames %.2f px",
            contradiction.std_px,
            contradiction.others_std_px,
            contradiction.own_std_px);
  }
  return described;
}

SelectedTracks SelectTracks(const MultiFrameOptions& options,
                            const Scene& scene) {
  SelectedTracks selected;
  selected.selection =
      HoldOutTracks(options.held_out_share,
                    scene,
                    SelectStaticPoints(options.static_points,
                                       scene,
                                       &selected.static_points,
                                       options.EffectiveNumThreads()));
  return selected;
}

RefinementResult RefineScene(const MultiFrameOptions& options,
                             const StageCallback& callback,
                             const Capture& capture,
                             const Scene& scene,
                             Estimate start) {
  const bool has_schedule = options.NumScheduleSolves() > 0;
  if (has_schedule) {
    start = RunSchedule(options, callback, capture, scene, std::move(start));
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
  final_options.extrinsics_translation_std *= capture.new_from_rig.scale;
  return RefineFixedExtrinsics(
      final_options, !has_schedule, callback, scene, std::move(start));
}

Tracks RetriangulateInRounds(const MultiFrameOptions& options,
                             const TriangulatorOptions& track_options,
                             const std::filesystem::path& work_path,
                             const Start& start,
                             Capture capture,
                             Progress* progress) {
  Tracks tracks;
  tracks.capture = std::move(capture);
  tracks.scene = start.scene;
  tracks.estimate = start.estimate;
  const int num_rounds = options.retriangulation_rounds;
  double tolerance_px = std::numeric_limits<double>::infinity();
  for (int round = 1; round <= num_rounds && HasDatabases(tracks.capture);
       ++round) {
    tracks = RefineRound(options, start, std::move(tracks), progress);
    progress->Heading("Retriangulating frames");
    Retriangulation retriangulation = RetriangulateFrames(options,
                                                          track_options,
                                                          work_path,
                                                          tracks.capture,
                                                          tracks.scene,
                                                          tracks.estimate);
    tracks.capture = LeaveUnusableDatabases(
        retriangulation.failures, *progress, std::move(tracks.capture));
    size_t num_points = 0;
    size_t num_observations = 0;
    CountTracks(tracks.scene, &num_points, &num_observations);
    LogRetriangulation(
        retriangulation,
        tracks.scene,
        std::to_string(round) + " / " + std::to_string(num_rounds),
        num_points,
        num_observations,
        *progress);
    const bool is_better =
        retriangulation.tolerance_px < (1.0 - kMinImprovement) * tolerance_px ||
        retriangulation.num_observations >
            (1.0 + kMinImprovement) * num_observations;
    if (retriangulation.num_frames == 0 || !is_better) {
      progress->Log("No improvement: the tracks stay as they were");
      break;
    }
    tolerance_px = retriangulation.tolerance_px;
    tracks = ReplaceTracks(std::move(retriangulation), std::move(tracks));
  }
  return tracks;
}

Tracks RefineKeypoints(const MultiFrameOptions& options,
                       const std::string& image_path,
                       const Start& start,
                       Tracks tracks,
                       Progress* progress) {
  if (options.refine_keypoints != 1 && options.complete_tracks != 1) {
    return tracks;
  }
  if (!tracks.refinement) {
    tracks = RefineRound(options, start, std::move(tracks), progress);
  }
  progress->Heading("Refining keypoints");
  KeypointRefinement refined = RefineKeypoints(
      options,
      image_path,
      [&](const std::string& line) { progress->Log(line); },
      tracks.scene,
      tracks.estimate);
  const KeypointStatistics& statistics = refined.statistics;
  progress->Log(host::StringPrintf(
      "Keypoints refined in %zu of %zu frames: of %zu observations %zu "
      "aligned, %zu reference, %zu dropped; %zu added",
      statistics.num_frames,
      Sum(*tracks.scene.ranks, tracks.scene.frames.size()),
      statistics.num_before,
      statistics.num_aligned,
      statistics.num_reference,
      statistics.num_dropped,
      statistics.num_added));
  tracks.keypoints = statistics;
  if (statistics.num_frames == 0) return tracks;
  tracks.capture = ReplaceKeypoints(refined, std::move(tracks.capture));
  tracks.scene.frames = std::move(refined.frames);
  for (size_t f = 0; f < refined.points.size(); ++f) {
    tracks.estimate.frames[f].points = std::move(refined.points[f]);
  }
  tracks.are_new = true;
  tracks.refinement.reset();
  return tracks;
}

RefinedTracks RefineTracks(const MultiFrameOptions& options,
                           const std::string& image_path,
                           const Tracks& tracks,
                           const Selection& selection,
                           Progress* progress) {
  SceneEstimate fitted = SelectTracks(
      selection, TrackRole::kFitted, tracks.scene, tracks.estimate);
  const bool has_features = options.dense_features != "none";
  if (has_features) {
    progress->Heading("Computing dense features");
    fitted.scene = AddDenseFeatures(
        options,
        image_path,
        [&](const std::string& line) { progress->Log(line); },
        std::move(fitted.scene));
  }
  progress->Heading("Refining intrinsics");
  RefinedTracks refined;
  refined.took_part = ObservedCameras(fitted.scene);
  refined.refinement = tracks.refinement && !has_features
                           ? *tracks.refinement
                           : RefineScene(options,
                                         progress->RecordStages(),
                                         tracks.capture,
                                         fitted.scene,
                                         std::move(fitted.estimate));
  refined.estimate = JoinEstimates(selection,
                                   TrackRole::kFitted,
                                   refined.refinement.estimate,
                                   tracks.estimate);
  for (const TrackRole role :
       {TrackRole::kHeldOut, TrackRole::kMerged, TrackRole::kDropped}) {
    const SceneEstimate others = FitTracks(
        options, tracks, selection, role, refined.refinement.estimate);
    if (role == TrackRole::kHeldOut) {
      refined.held_out_rms_px = InlierRms(
          SquaredResiduals(
              others.scene, others.estimate, options.SingleFrameMode()),
          *others.scene.ranks);
    }
    refined.estimate = JoinEstimates(
        selection, role, others.estimate, std::move(refined.estimate));
  }
  return refined;
}

Estimate WithInitialIntrinsics(const Scene& scene, Estimate estimate) {
  for (size_t i = 0; i < scene.cameras.size(); ++i) {
    estimate.cameras[i].params = scene.cameras[i].params;
  }
  for (size_t f = 0; f < scene.frames.size(); ++f) {
    for (size_t i = 0; i < scene.frames[f].images.size(); ++i) {
      estimate.frames[f].images[i].params =
          scene.cameras[scene.frames[f].images[i].camera_idx].params;
    }
  }
  return estimate;
}

}  // namespace mfir
