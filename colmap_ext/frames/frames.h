// The frames of a capture as COLMAP reconstructions, restricted to the cameras
// of the rig.

#pragma once

#include <map>
#include <memory>
#include <string>
#include <vector>

#include "colmap_ext/host/reconstruction.h"
#include "colmap_ext/rigs/rig_io.h"
#include "src/parallel/communicator.h"
#include "src/refinement/options.h"
#include "src/scene/estimate.h"
#include "src/scene/scene.h"
#include "src/sensor/unmatched_names.h"

namespace mfir {

struct FrameModel {
  std::string name;
  std::string model_path;
  // The model has other frames, too: image names differ between frames.
  bool is_part_of_model = false;
  // COLMAP database with the keypoints and matches; empty: there is none.
  std::string database_path;
  // Why the frame takes no part; empty: it does.
  std::string skip_reason;
  // Images of rig cameras only. Every image has a camera of its own, whose id
  // is the rig camera's index + 1.
  std::unique_ptr<host::Reconstruction> reconstruction;
  std::map<size_t, host::image_t> image_ids;  // by index of the rig camera
  // After AlignFrames: RMS distance of the inliers' camera centres from the
  // known ones, in units of the rig.
  double alignment_rms = 0.0;
};

struct Capture {
  // After AlignFrames: the coordinates of the reconstructions.
  Similarity3 new_from_rig;
  // The cameras of RIG, in the order of their names, that have images.
  std::vector<KnownCamera> cameras;
  std::vector<FrameModel> frames;  // in the order of their names
  // Left out, for the report.
  std::vector<std::string> cameras_without_images;
  std::vector<std::string> images_without_camera;  // "FRAME/IMAGE"
  ImageOfName image_of_unknown_name;               // of the latter
  // Each has a run of the capture's frames, and all have the same cameras.
  const Communicator* ranks = &Alone();

  // Those that take part, as Scene::frames.
  std::vector<const FrameModel*> UsedFrames() const;
  size_t NumUsedFrames() const { return UsedFrames().size(); }
};

// Names of the frames in `frames_path`, the value of the option `option_name`,
// sorted: its sub-folders, or those that `frame_list_path` (if not empty)
// names, one per line. Throws InputError when there is none or one of the list
// does not exist.
std::vector<std::string> ListFrames(const std::string& option_name,
                                    const std::string& frames_path,
                                    const std::string& frame_list_path);

// Reads all frames in `frames_path` (frame_source.h), matches their images with
// the cameras of `rig`, and converts cameras to options.camera_model if set.
// Frames without a model, with fewer than three cameras of the rig, or without
// points are skipped with a reason. Throws InputError: no frames, a frame of
// the list that does not exist, unreadable models, two images of a frame with
// the same camera, camera models or image sizes of a camera that differ between
// frames or from RIG, no image of any camera of the rig, no usable frame.
//
// Over ranks each reads its share of the frames; UsageError if there are fewer
// frames than ranks.
Capture ReadCapture(const std::string& frames_path,
                    const std::string& frame_list_path,
                    const Rig& rig,
                    const MultiFrameOptions& options,
                    const Communicator& ranks = Alone());

// Without cameras that no used frame of any rank has; the others are
// renumbered.
Capture RemoveCamerasWithoutImages(Capture capture);

// The capture with each frame robustly (AlignPoses) moved into the coordinates
// `new_from_rig` away from the rig's. Skips frames that do not align; throws
// InputError if none does, or if most fit the rig far better in another
// convention of poses.
Capture AlignFrames(const Similarity3& new_from_rig, Capture capture);

// Ids of the images of a FrameModel's reconstruction, by index of the rig
// camera.
std::map<size_t, host::image_t> ImageIdsByCamera(
    const host::Reconstruction& reconstruction);

// Ids of all points, ascending: the order of the tracks of a Frame.
std::vector<host::point3D_t> SortedPointIds(
    const host::Reconstruction& reconstruction);

// Arrays of the used frames of an aligned capture; the estimate has what the
// frames' reconstructions have. Ordered by camera, image and point id, so that
// the order on disk does not matter. Intrinsics of the rig's cameras are not
// set.
// Throws InputError if cameras differ between ranks.
SceneEstimate BuildScene(const Capture& capture);

// The reconstruction of the frame scene.frames[frame_idx] with what was
// refined, in the rig's coordinates, `rig_from_new` away: its points, and poses
// and intrinsics of `cameras`, or the frame's own intrinsics where
// `single_frame_mode`. Point errors are the mean reprojection errors (px), as
// in COLMAP.
host::Reconstruction RefinedReconstruction(
    const Similarity3& rig_from_new,
    const FrameModel& model,
    const Scene& scene,
    const Estimate& estimate,
    size_t frame_idx,
    const std::vector<KnownCamera>& cameras,
    bool single_frame_mode);

}  // namespace mfir
