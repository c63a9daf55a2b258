// The command multi_frame_intrinsics_refiner.

#include <algorithm>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <iostream>
#include <limits>

#include "colmap_ext/controllers/refiner_progress.h"
#include "colmap_ext/controllers/refiner_solves.h"
#include "colmap_ext/controllers/scene_features.h"
#include "colmap_ext/exe/command.h"
#include "colmap_ext/exe/refiner_options.h"
#include "colmap_ext/exe/result_writer.h"
#include "colmap_ext/feature/dense_feature_sources.h"
#include "colmap_ext/frames/frames.h"
#include "colmap_ext/host/compat.h"
#include "colmap_ext/io/input_file.h"
#include "colmap_ext/rigs/rig_io.h"
#include "src/evaluation/drift_check.h"
#include "src/evaluation/evaluation.h"
#include "src/geometry/alignment.h"
#include "src/refinement/held_out_tracks.h"
#include "src/refinement/refinement.h"
#include "src/refinement/static_points.h"
#include "src/scene/residual_statistics.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

void LogCapture(const Rig& rig,
                const Capture& capture,
                const Progress& progress) {
  progress.Log(colmap::StringPrintf(
      "%zu of %zu cameras of the rig (%s) have images, %zu of %zu frames are "
      "used",
      capture.cameras.size(),
      rig.cameras.size(),
      rig.format.c_str(),
      capture.NumUsedFrames(),
      capture.frames.size()));
  for (const std::string& name : capture.cameras_without_images) {
    progress.Log("Left out: camera '" + name + "' of the rig has no image");
  }
  for (const std::string& name : capture.images_without_camera) {
    progress.Log("Left out: image '" + name + "' has no camera in the rig");
  }
}

// Models of frames may lie elsewhere, by links.
std::vector<std::string> ModelPaths(const Capture& capture) {
  std::vector<std::string> paths;
  for (const FrameModel& frame : capture.frames) {
    paths.push_back(frame.model_path);
  }
  return paths;
}

// Replaces the start by the intrinsics of RIG.
void UsePriorIntrinsics(const Capture& capture, Scene* scene) {
  for (size_t i = 0; i < scene->cameras.size(); ++i) {
    const KnownCamera& known = capture.cameras[i];
    RigCamera& camera = scene->cameras[i];
    if (known.model != camera.model) {
      throw InputError(
          "--MultiFrame.use_prior_intrinsics: camera '" + known.name +
          "' has " +
          (known.model == nullptr ? "no intrinsics"
                                  : "the camera model " + known.model->Name()) +
          " in the extrinsics file, but " + camera.model->Name() +
          " in the frames. Convert with --MultiFrame.camera_model.");
    }
    camera.params = known.params;
    camera.prior_params = known.params;
    for (Frame& frame : scene->frames) {
      for (FrameImage& image : frame.images) {
        if (image.camera_idx == i) image.params = known.params;
      }
    }
  }
}

// Marks the cameras of the list.
void HoldConstantCameras(const std::string& path, Scene* scene) {
  if (path.empty()) return;
  for (const ListEntry& entry :
       ReadNameList("--constant_camera_list_path", path)) {
    const std::string name = CanonicalCameraName(entry.name);
    const auto camera = std::find_if(
        scene->cameras.begin(),
        scene->cameras.end(),
        [&](const RigCamera& other) { return other.name == name; });
    if (camera == scene->cameras.end()) {
      throw InputError(entry.where + "there is no camera '" + entry.name +
                       "' with images. Correct or remove the line.");
    }
    camera->constant_intrinsics = true;
  }
}

// The extrinsics in the coordinates of RIG: the known ones, or corrected.
std::vector<KnownCamera> RefinedCameras(const MultiFrameOptions& options,
                                        const Similarity3& normalized_from_rig,
                                        const Capture& capture,
                                        const Scene& scene) {
  const Similarity3 rig_from_normalized = Inverse(normalized_from_rig);
  std::vector<KnownCamera> cameras = capture.cameras;
  for (size_t i = 0; i < cameras.size(); ++i) {
    const RigCamera& camera = scene.cameras[i];
    cameras[i].model = camera.model;
    cameras[i].width = camera.width;
    cameras[i].height = camera.height;
    cameras[i].params = camera.params;
    if (options.SoftExtrinsics()) {
      cameras[i].matrix.reset();
      cameras[i].cam_from_world =
          TransformPose(rig_from_normalized, camera.cam_from_world);
      cameras[i].cam_from_world.rotation =
          StableQuaternion(cameras[i].cam_from_world.rotation);
    }
  }
  return cameras;
}

// Empty without a ground truth.
std::vector<CameraIntrinsics> ReadTrueCameras(const RefinerOptions& options) {
  std::vector<CameraIntrinsics> cameras;
  if (options.ground_truth_path.empty()) return cameras;
  const Rig truth = ReadRig(options.ground_truth_path,
                            options.ground_truth_format,
                            CameraNaming(options.multi_frame.camera_name_regex),
                            std::numeric_limits<double>::quiet_NaN());
  for (const KnownCamera& camera : truth.cameras) {
    cameras.push_back({camera.name,
                       camera.model,
                       camera.width,
                       camera.height,
                       camera.params});
  }
  return cameras;
}

// Null without a ground truth.
nlohmann::ordered_json Evaluate(const std::vector<CameraIntrinsics>& truth,
                                const Scene& scene,
                                bool quiet) {
  if (truth.empty()) return nullptr;
  FrameEstimate estimate;
  for (const RigCamera& camera : scene.cameras) {
    estimate.cameras.push_back({camera.name,
                                camera.model,
                                camera.width,
                                camera.height,
                                camera.params});
  }
  const Evaluation evaluation = EvaluateIntrinsics({estimate}, truth);
  if (!quiet) {
    PrintEvaluation(evaluation, std::cout);
  }
  return EvaluationToJson(evaluation);
}

nlohmann::ordered_json DescribeInputs(const RefinerOptions& options,
                                      const Rig& rig,
                                      const Capture& capture) {
  return {{"input_path", options.input_path},
          {"extrinsics_path", options.extrinsics_path},
          {"extrinsics_format", rig.format},
          {"image_path", options.image_path},
          {"num_rig_cameras", rig.cameras.size()},
          {"cameras_without_images", capture.cameras_without_images},
          {"images_without_camera", capture.images_without_camera}};
}

void LogAlignment(const Capture& capture, const Progress& progress) {
  for (const FrameModel& frame : capture.frames) {
    progress.Log(
        "Frame '" + frame.name + "': " +
        (frame.skip_reason.empty()
             ? colmap::StringPrintf("rms of the camera centres %g rig units",
                                    frame.alignment_rms)
             : "skipped: " + frame.skip_reason));
  }
}

void LogStaticPoints(const MultiFrameOptions& options,
                     const StaticPoints& static_points,
                     const Scene& scene,
                     const Progress& progress) {
  if (scene.frames.size() < 2) return;
  progress.Log(colmap::StringPrintf(
      "Static points: %zu, %.1f %% of the observations (static_points %s)",
      static_points.NumPoints(),
      100.0 * static_points.ObservationShare(),
      options.static_points.c_str()));
  if (options.static_points != "drop") return;
  for (const Frame& frame : scene.frames) {
    if (frame.points.empty()) {
      progress.Log("Frame '" + frame.name +
                   "' has static points only and takes no part");
    }
  }
}

std::vector<bool> ObservedCameras(const Scene& scene) {
  std::vector<bool> observed(scene.cameras.size(), false);
  for (const Frame& frame : scene.frames) {
    for (const Observation& observation : frame.observations) {
      observed[frame.images[observation.image_idx].camera_idx] = true;
    }
  }
  return observed;
}

// On stderr, also when quiet: the result is not what the user expects.
void WarnOfContradictions(const Capture& capture) {
  for (const auto& name_and_reason : capture.contradicting_cameras) {
    std::cerr << "WARNING: camera '" << name_and_reason.first
              << "' contradicts its extrinsics in RIG: "
              << name_and_reason.second
              << ". Was it moved, or has it another camera's name? Correct "
                 "RIG, or leave the camera out of it."
              << std::endl;
  }
}

// Changes of the cameras that could change, since their start and since the
// intrinsics of RIG, where these are of the same model.
void MeasureDrifts(const Capture& capture,
                   const Scene& scene,
                   RefinerResult* result) {
  DriftReference start(scene.cameras.size());
  DriftReference rig(scene.cameras.size());
  for (size_t i = 0; i < scene.cameras.size(); ++i) {
    const RigCamera& camera = scene.cameras[i];
    if (camera.constant_intrinsics || !result->took_part[i]) continue;
    start[i] = result->initial_params[i];
    if (capture.cameras[i].model == camera.model) {
      rig[i] = capture.cameras[i].params;
    }
  }
  result->drifts = FindDrifts(scene.cameras, start);
  result->drifts_from_rig = FindDrifts(scene.cameras, rig);
}

void WarnOfDrift(const std::string& name,
                 const std::string& since,
                 const CameraDrift& drift) {
  std::cerr << "WARNING: camera '" << name << "' has changed unusually since "
            << since << ": "
            << colmap::StringPrintf(
                   "focal length %.2f permille (the other cameras %.2f), "
                   "principal point (%.2f, %.2f) px (the others %.2f), %.1f "
                   "robust standard deviations",
                   drift.focal_permille,
                   drift.others_focal_permille,
                   drift.principal_point.x(),
                   drift.principal_point.y(),
                   drift.others_principal_point,
                   std::max(drift.focal_stds, drift.principal_point_stds))
            << ". A camera that was bumped looks like this. If so, correct its "
               "pose in RIG, or leave the camera out of it."
            << std::endl;
}

// On stderr, also when quiet: the result is not what the user expects.
void WarnOfBumpedCameras(const RefinerResult& result, const Scene& scene) {
  for (size_t i = 0; i < scene.cameras.size(); ++i) {
    const std::string& name = scene.cameras[i].name;
    const PoseDisagreement& pose = result.pose_disagreements[i];
    if (pose.is_moved) {
      std::cerr << "WARNING: camera '" << name << "' has moved: "
                << colmap::StringPrintf(
                       "in the frames it is turned by %.2f degrees against "
                       "RIG (the other cameras by %.3f)",
                       pose.angle_deg,
                       pose.others_deg)
                << ". Correct its pose in RIG, or leave the camera out of it."
                << std::endl;
    }
    if (result.drifts[i] && result.drifts[i]->is_unusual) {
      WarnOfDrift(name, "its start", *result.drifts[i]);
    } else if (result.drifts_from_rig[i] &&
               result.drifts_from_rig[i]->is_unusual) {
      WarnOfDrift(name, "RIG", *result.drifts_from_rig[i]);
    }
  }
}

// Throws SolverError with the cure.
void ThrowUnlessConverged(const RefinerResult& result,
                          const SpoiltCameras& spoilt,
                          int max_num_iterations,
                          const std::string& path) {
  if (result.status == "converged") return;
  std::string names;
  for (const auto& name_and_reason : result.capture->contradicting_cameras) {
    names += (names.empty() ? "'" : ", '") + name_and_reason.first + "'";
  }
  const std::string where =
      "the result is in " + path + ", with status " + result.status + ". ";
  if (result.status == "contradicting_extrinsics" && names.empty()) {
    throw SolverError(
        "The frames contradict the extrinsics in RIG: the residuals or focal "
        "lengths of " +
        std::to_string(spoilt.num_spoilt) + " of " +
        std::to_string(spoilt.num_others) + " cameras are absurd; " + where +
        "Is it the RIG of this array, with the right name at every camera?");
  }
  if (result.status == "contradicting_extrinsics") {
    throw SolverError(
        "Cameras that contradict their extrinsics in RIG (" + names +
        ") have spoilt " + std::to_string(spoilt.num_spoilt) + " of the " +
        std::to_string(spoilt.num_others) +
        " others: their residuals or focal lengths are absurd; " + where +
        "Correct these cameras in RIG, or remove them "
        "from it, and run again.");
  }
  throw SolverError(
      "The last solve did not converge within " +
      std::to_string(max_num_iterations) + " iterations; " + where +
      (names.empty()
           ? "Raise --MultiFrame.max_num_iterations."
           : "Correct the cameras that contradict their "
             "extrinsics in RIG (" +
                 names + "), or remove them from it, and run again."));
}

void Refine(const RefinerOptions& options, const OptionParser& parser) {
  const MultiFrameOptions& multi_frame = options.multi_frame;
  Progress progress(options.multi_frame);
  OutputFolder output(options.output_path,
                      ResultNames(),
                      options.input_path,
                      {options.extrinsics_path,
                       options.image_path,
                       options.ground_truth_path,
                       options.frame_list_path,
                       options.constant_camera_list_path});

  progress.Heading("Reading frames");
  const Rig rig = ReadRig(options.extrinsics_path,
                          options.extrinsics_format,
                          CameraNaming(multi_frame.camera_name_regex),
                          options.extrinsics_pixel_offset);
  const std::vector<CameraIntrinsics> true_cameras = ReadTrueCameras(options);
  Capture capture = ReadCapture(
      options.input_path, options.frame_list_path, rig, multi_frame);
  output.CheckKeeps(ModelPaths(capture));
  LogCapture(rig, capture, progress);
  WarnOfUnmatchedNames(
      capture.cameras_without_images, capture.image_of_unknown_name, std::cerr);
  if (multi_frame.featuremetric_weight > 0.0 &&
      multi_frame.dense_features == "none") {
    progress.Log(
        "No images (--image_path), no dense features: featuremetric_weight "
        "weighs nothing");
  }

  progress.Heading("Aligning frames");
  std::vector<Rigid3> rig_poses;
  for (const KnownCamera& camera : rig.cameras) {
    rig_poses.push_back(camera.cam_from_world);
  }
  const Similarity3 normalized_from_rig = NormalizeRig(rig_poses);
  AlignFrames(normalized_from_rig, &capture);
  LogAlignment(capture, progress);

  Scene scene = BuildScene(normalized_from_rig, capture);
  HoldConstantCameras(options.constant_camera_list_path, &scene);
  InitializeIntrinsics(multi_frame, &scene);
  if (multi_frame.use_prior_intrinsics) UsePriorIntrinsics(capture, &scene);
  // A ground truth that does not fit fails here, not after the work.
  Evaluate(true_cameras, scene, true);
  RefinerResult result;
  for (const RigCamera& camera : scene.cameras) {
    result.initial_params.push_back(camera.params);
  }
  result.pose_disagreements = FindPoseDisagreements(scene);
  Scene start = scene;
  const StartResiduals start_residuals = EvaluateStart(multi_frame, start);
  const RoundsResult rounds = RetriangulateInRounds(multi_frame,
                                                    options.tracks,
                                                    normalized_from_rig,
                                                    output.TemporaryPath(),
                                                    start_residuals,
                                                    &progress,
                                                    &result.stages,
                                                    &capture,
                                                    &scene);
  StaticPoints static_points(multi_frame.static_points, &scene);
  LogStaticPoints(multi_frame, static_points, scene, progress);
  HeldOutTracks held_out(multi_frame.held_out_share, &scene);
  if (multi_frame.dense_features != "none") {
    progress.Heading("Computing dense features");
    AddDenseFeatures(
        multi_frame,
        options.image_path,
        [&](const std::string& line) { progress.Log(line); },
        &scene);
  }

  progress.Heading("Refining intrinsics");
  const bool single_frame_mode = multi_frame.SingleFrameMode();
  if (rounds.refinement && multi_frame.dense_features == "none") {
    result.refinement = *rounds.refinement;
  } else {
    result.refinement = RefineScene(multi_frame,
                                    normalized_from_rig,
                                    progress.RecordStages(&result.stages),
                                    &capture,
                                    &scene);
  }
  result.took_part = ObservedCameras(scene);
  result.held_out_rms_px = held_out.Evaluate(multi_frame, scene);
  held_out.PutBack(&scene);
  static_points.FitPoints(multi_frame, scene);
  static_points.PutBack(&scene);
  if (rounds.has_new_tracks) {
    start = WithIntrinsics(result.initial_params, scene);
  }
  const std::vector<double> residuals_before =
      SquaredResiduals(start, single_frame_mode);
  const std::vector<double> residuals_after =
      SquaredResiduals(scene, single_frame_mode);
  std::vector<double> stds_px = RobustStdByCamera(scene, residuals_after);
  for (size_t i = 0; i < stds_px.size(); ++i) {
    // Nothing was fitted to what it has seen.
    if (!result.took_part[i]) stds_px[i] = std::nan("");
  }
  const std::vector<ExtrinsicsContradiction> contradictions =
      AddContradictions(scene, start_residuals, stds_px, &capture);
  WarnOfContradictions(capture);
  MeasureDrifts(capture, scene, &result);
  WarnOfBumpedCameras(result, scene);
  const SpoiltCameras spoilt = CountSpoiltCameras(scene,
                                                  result.initial_params,
                                                  contradictions,
                                                  stds_px,
                                                  start_residuals.own_stds_px);
  // The same observations before and after.
  const double max_squared = MaxInlierSquaredResidual(residuals_after);
  std::vector<bool> inliers;
  for (const double squared : residuals_after) {
    inliers.push_back(squared <= max_squared);
  }
  result.rms_px_before = RmsByCamera(scene, residuals_before, inliers);
  result.rms_px_after = RmsByCamera(scene, residuals_after, inliers);
  // Intrinsics of a soft solve need not fit the known extrinsics.
  const bool contradicts =
      spoilt.Most() && (!contradictions.empty() || multi_frame.progressive);
  result.status = contradicts                   ? "contradicting_extrinsics"
                  : result.refinement.converged ? "converged"
                                                : "not_converged";
  const std::string held_out_rms =
      std::isfinite(result.held_out_rms_px)
          ? colmap::StringPrintf("%.3f px held out, ", result.held_out_rms_px)
          : "";
  progress.Log(
      colmap::StringPrintf("%s: rms %.3f px before, %.3f px after, %snoise "
                           "%.3f px, outliers %.1f %%",
                           result.status.c_str(),
                           result.rms_px_before.back(),
                           result.rms_px_after.back(),
                           held_out_rms.c_str(),
                           result.refinement.noise_std_px,
                           100.0 * result.refinement.outlier_share));

  progress.Heading("Writing result");
  result.cameras =
      RefinedCameras(multi_frame, normalized_from_rig, capture, scene);
  result.soft_extrinsics = multi_frame.SoftExtrinsics();
  result.evaluation = Evaluate(true_cameras, scene, multi_frame.quiet);
  result.inputs = DescribeInputs(options, rig, capture);
  result.static_points = &static_points;
  UpdateReconstructions(
      normalized_from_rig, scene, result.cameras, single_frame_mode, &capture);
  result.capture = &capture;
  result.scene = &scene;
  result.timings_s = progress.Timings();
  const WrittenResult written = WriteResult(parser, result, &output);
  for (const std::string& remark : written.remarks) progress.Log(remark);
  progress.Log("Written to " + written.path);
  ThrowUnlessConverged(
      result, spoilt, multi_frame.max_num_iterations, written.path);
}

}  // namespace

int RunMultiFrameIntrinsicsRefiner(int argc, char** argv) {
  return RunCommand([argc, argv]() {
    RefinerOptions options;
    OptionParser parser;
    ParseRefinerOptions(argc, argv, &options, &parser);
    Refine(options, parser);
  });
}

}  // namespace mfir
