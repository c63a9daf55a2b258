// Alignment of the frames to the rig.

#include <algorithm>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "colmap_ext/frames/frames.h"
#include "src/geometry/alignment.h"
#include "src/geometry/pose_conventions.h"
#include "src/parallel/parallel_for.h"
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
  const std::vector<const FrameModel*> frames = capture.UsedFrames();
  std::vector<const PoseConvention*> found(frames.size());
  ParallelFor(frames.size(), -1, [&](size_t i) {
    const FramePoses poses = PosesOf(*frames[i], capture);
    found[i] = FindPoseConvention(poses.frame, poses.rig);
  });
  std::map<const PoseConvention*, size_t> num_frames;
  for (const PoseConvention* convention : found) ++num_frames[convention];
  // Over ranks it is for those most of whose frames say so, if they have most
  // of the frames.
  const bool says_so =
      std::any_of(num_frames.begin(), num_frames.end(), [&](const auto& count) {
        return count.first != nullptr &&
               2 * count.second > capture.NumUsedFrames();
      });
  const size_t num_saying =
      Sum(*capture.ranks, says_so ? capture.NumUsedFrames() : size_t{0});
  if (2 * num_saying <= Sum(*capture.ranks, capture.NumUsedFrames())) return;
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
  std::vector<std::string> failures(capture.frames.size());
  ParallelFor(capture.frames.size(), -1, [&](size_t i) {
    FrameModel& frame = capture.frames[i];
    if (!frame.skip_reason.empty()) return;
    const FramePoses poses = PosesOf(frame, capture);
    const PoseAlignment alignment = AlignPoses(poses.frame, poses.rig);
    if (!alignment.failure.empty()) {
      failures[i] = "frame '" + frame.name + "': " + alignment.failure;
      frame.skip_reason = alignment.failure;
      frame.reconstruction.reset();
      return;
    }
    frame.alignment_rms = alignment.rms_center_error;
    host::TransformReconstruction(new_from_rig * alignment.target_from_source,
                                  frame.reconstruction.get());
  });
  for (const std::string& failure : failures) {
    if (first_failure.empty()) first_failure = failure;
  }
  if (Sum(*capture.ranks, capture.NumUsedFrames()) == 0) {
    throw InputError("No frame can be aligned to the known extrinsics (" +
                     first_failure + "). Is it the RIG of this array?");
  }
  return RemoveCamerasWithoutImages(std::move(capture));
}

}  // namespace mfir
