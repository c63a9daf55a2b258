// Alignment of the frames to the rig.

#include "colmap_ext/frames.h"
#include "src/alignment.h"
#include "src/errors.h"

namespace mfir {
void AlignFrames(const Similarity3& new_from_rig, Capture* capture) {
  std::string first_failure;
  for (FrameModel& frame : capture->frames) {
    if (!frame.skip_reason.empty()) continue;
    std::vector<Rigid3> frame_poses;
    std::vector<Rigid3> rig_poses;
    for (const auto& idx_and_image : frame.image_ids) {
      frame_poses.push_back(
          CamFromWorld(frame.reconstruction->Image(idx_and_image.second)));
      rig_poses.push_back(capture->cameras[idx_and_image.first].cam_from_world);
    }
    const PoseAlignment alignment = AlignPoses(frame_poses, rig_poses);
    if (!alignment.failure.empty()) {
      frame.skip_reason = alignment.failure;
      frame.reconstruction.reset();
      if (first_failure.empty()) {
        first_failure = "frame '" + frame.name + "': " + alignment.failure;
      }
      continue;
    }
    frame.alignment_rms = alignment.rms_center_error;
    TransformReconstruction(new_from_rig * alignment.target_from_source,
                            frame.reconstruction.get());
  }
  if (capture->NumUsedFrames() == 0) {
    throw InputError("No frame can be aligned to the known extrinsics (" +
                     first_failure + "). Is it the RIG of this array?");
  }
  RemoveCamerasWithoutImages(capture);
}

}  // namespace mfir
