#include "colmap_ext/exe/refiner_inputs.h"

#include "colmap_ext/exe/input_files.h"

#include <algorithm>
#include <iostream>
#include <limits>
#include <utility>

#include "colmap_ext/host/util.h"
#include "colmap_ext/io/input_file.h"
#include "colmap_ext/refinement/refiner_solves.h"
#include "src/geometry/alignment.h"
#include "src/refinement/initial_intrinsics.h"
#include "src/sensor/unmatched_names.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

void LogCapture(const Rig& rig,
                const Capture& capture,
                const Progress& progress) {
  progress.Log(host::StringPrintf(
      "%zu of %zu cameras of the rig (%s) have images, %zu of %zu frames are "
      "used",
      capture.cameras.size(),
      rig.cameras.size(),
      rig.format.c_str(),
      Sum(*capture.ranks, capture.NumUsedFrames()),
      Sum(*capture.ranks, capture.frames.size())));
  for (const std::string& name : capture.cameras_without_images) {
    progress.Log("Left out: camera '" + name + "' of the rig has no image");
  }
  for (const std::string& name : capture.images_without_camera) {
    progress.Log("Left out: image '" + name + "' has no camera in the rig");
  }
}

void LogAlignment(const Capture& capture, const Progress& progress) {
  for (const FrameModel& frame : capture.frames) {
    progress.Log(
        "Frame '" + frame.name + "': " +
        (frame.skip_reason.empty()
             ? host::StringPrintf("rms of the camera centres %g rig units",
                                  frame.alignment_rms)
             : "skipped: " + frame.skip_reason));
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
SceneEstimate UsePriorIntrinsics(const Capture& capture, SceneEstimate start) {
  for (size_t i = 0; i < start.scene.cameras.size(); ++i) {
    const KnownCamera& known = capture.cameras[i];
    RigCamera& camera = start.scene.cameras[i];
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
  }
  start.estimate =
      WithInitialIntrinsics(start.scene, std::move(start.estimate));
  return start;
}

// Marks the cameras of the list.
Scene HoldConstantCameras(const std::string& path, Scene scene) {
  if (path.empty()) return scene;
  for (const ListEntry& entry :
       ReadNameList("--constant_camera_list_path", path)) {
    const std::string name = CanonicalCameraName(entry.name);
    const auto camera = std::find_if(
        scene.cameras.begin(),
        scene.cameras.end(),
        [&](const RigCamera& other) { return other.name == name; });
    if (camera == scene.cameras.end()) {
      throw InputError(entry.where + "there is no camera '" + entry.name +
                       "' with images. Correct or remove the line.");
    }
    camera->constant_intrinsics = true;
  }
  return scene;
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

}  // namespace

RefinerInputs ReadInputs(const RefinerOptions& options,
                         const Communicator& ranks,
                         const OutputFolder& output,
                         Progress* progress) {
  const MultiFrameOptions& multi_frame = options.multi_frame;
  progress->Heading("Reading frames");
  RefinerInputs inputs;
  inputs.rig = ReadRig(options.extrinsics_path,
                       options.extrinsics_format,
                       CameraNaming(multi_frame.camera_name_regex),
                       options.extrinsics_pixel_offset);
  inputs.rig.scale_intrinsics = options.scale_intrinsics;
  for (const std::string& remark : inputs.rig.remarks) progress->Log(remark);
  inputs.true_cameras = ReadTrueCameras(options);
  Capture capture = ReadCapture(options.input_path,
                                options.frame_list_path,
                                inputs.rig,
                                multi_frame,
                                ranks);
  output.CheckKeeps(ModelPaths(capture));
  LogCapture(inputs.rig, capture, *progress);
  if (ranks.IsFirst()) {
    WarnOfUnmatchedNames(capture.cameras_without_images,
                         capture.image_of_unknown_name,
                         std::cerr);
  }
  if (multi_frame.featuremetric_weight > 0.0 &&
      multi_frame.dense_features == "none") {
    progress->Log(std::string(options.image_path.empty()
                                  ? "No images (--image_path), no"
                                  : "No") +
                  " dense features: featuremetric_weight weighs nothing");
  }
  progress->Heading("Aligning frames");
  std::vector<Rigid3> rig_poses;
  for (const KnownCamera& camera : inputs.rig.cameras) {
    rig_poses.push_back(camera.cam_from_world);
  }
  inputs.capture = AlignFrames(NormalizeRig(rig_poses), std::move(capture));
  LogAlignment(inputs.capture, *progress);
  return inputs;
}

Start MakeStart(const RefinerOptions& options, const RefinerInputs& inputs) {
  SceneEstimate start = BuildScene(inputs.capture);
  start.scene = HoldConstantCameras(options.constant_camera_list_path,
                                    std::move(start.scene));
  start = InitializeIntrinsics(options.multi_frame, std::move(start));
  if (options.multi_frame.use_prior_intrinsics) {
    start = UsePriorIntrinsics(inputs.capture, std::move(start));
  }
  // A ground truth that does not fit fails here, not after the work.
  EvaluateCameras(inputs.true_cameras, start.estimate.cameras, nullptr);
  return EvaluateStart(options.multi_frame, std::move(start));
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
          {"images_without_camera", capture.images_without_camera},
          {"files", DescribeFiles(options, capture)}};
}

nlohmann::ordered_json EvaluateCameras(
    const std::vector<CameraIntrinsics>& truth,
    const std::vector<RigCamera>& cameras,
    std::ostream* report) {
  if (truth.empty()) return nullptr;
  FrameIntrinsics estimate;
  for (const RigCamera& camera : cameras) {
    estimate.cameras.push_back({camera.name,
                                camera.model,
                                camera.width,
                                camera.height,
                                camera.params});
  }
  const Evaluation evaluation = EvaluateIntrinsics({estimate}, truth);
  if (report != nullptr) PrintEvaluation(evaluation, *report);
  return EvaluationToJson(evaluation);
}

}  // namespace mfir
