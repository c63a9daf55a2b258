// Alignment of the frames to the rig.

#include <map>
#include <utility>

#include "colmap_ext/frames/frames.h"
#include "src/geometry/alignment.h"
#include "src/geometry/pose_conventions.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

struct FramePoses {
  std::vector<Rigid3> frame;
  std::vector<Rigid3> rig;
};

FramePoses PosesOf(const FrameModel& frame, const Capture& capture) {
  FramePoses poses;
  for (const auto& idx_and_image : frame.image_ids) {
    poses.frame.push_back(
        host::CamFromWorld(frame.reconstruction->Image(idx_and_image.second)));
    poses.rig.push_back(capture.cameras[idx_and_image.first].cam_from_world);
  }
  return poses;
}

// Throws if RIG fits most frames in another convention. Also where it fits
// them somehow as it is: arrays whose cameras lie nearly in a plane look like
// their mirror images.
void CheckPoseConvention(const Capture& capture) {
  std::map<const PoseConvention*, size_t> num_frames;
  for (const FrameModel& frame : capture.frames) {
    if (!frame.skip_reason.empty()) continue;
    const FramePoses poses = PosesOf(frame, capture);
    ++num_frames[FindPoseConvention(poses.frame, poses.rig)];
  }
  for (const auto& [convention, num] : num_frames) {
    if (convention == nullptr || 2 * num <= capture.NumUsedFrames()) continue;
    throw InputError("The known extrinsics fit " + std::to_string(num) +
                     " of " + std::to_string(capture.NumUsedFrames()) +
                     " frames in another convention of poses only: " +
                     PoseConventionAdvice(*convention));
  }
}

}  // namespace

Capture AlignFrames(const Similarity3& new_from_rig, Capture capture) {
  CheckPoseConvention(capture);
  capture.new_from_rig = new_from_rig;
  std::string first_failure;
  for (FrameModel& frame : capture.frames) {
    if (!frame.skip_reason.empty()) continue;
    const FramePoses poses = PosesOf(frame, capture);
    const PoseAlignment alignment = AlignPoses(poses.frame, poses.rig);
    if (!alignment.failure.empty()) {
      frame.skip_reason = alignment.failure;
      frame.reconstruction.reset();
      if (first_failure.empty()) {
        first_failure = "frame '" + frame.name + "': " + alignment.failure;
      }
      continue;
    }
    frame.alignment_rms = alignment.rms_center_error;
    host::TransformReconstruction(new_from_rig * alignment.target_from_source,
                                  frame.reconstruction.get());
  }
  if (capture.NumUsedFrames() == 0) {
    throw InputError("No frame can be aligned to the known extrinsics (" +
                     first_failure + "). Is it the RIG of this array?");
  }
  return RemoveCamerasWithoutImages(std::move(capture));
}

}  // namespace mfir
