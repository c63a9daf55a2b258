// Keypoints aligned and tracks completed on the images of a capture
// (track_refinement.h), once the intrinsics are nearly right.

#pragma once

#include <cstddef>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "colmap_ext/frames/frames.h"
#include "src/patches/track_refinement.h"
#include "src/refinement/options.h"
#include "src/scene/estimate.h"
#include "src/scene/scene.h"

namespace mfir {

struct KeypointStatistics {
  size_t num_frames = 0;  // changed
  size_t num_before = 0;  // observations
  size_t num_reference = 0;
  size_t num_aligned = 0;
  size_t num_added = 0;
  size_t num_dropped = 0;
  // By camera of the rig: observations that are reference, aligned or added,
  // and all, after.
  std::vector<size_t> num_refined_by_camera;
  std::vector<size_t> num_after_by_camera;
};

struct KeypointRefinement {
  // By frame of the scene; the statistics are those of all ranks.
  std::vector<Frame> frames;
  std::vector<std::vector<Eigen::Vector3d>> points;
  KeypointStatistics statistics;
};

// With the poses and intrinsics of the estimate. Holds the images of one frame
// at a time. Frames without images stay as they are. `log` takes lines. Throws
// InputError for an image that cannot be read or has another size.
KeypointRefinement RefineKeypoints(
    const MultiFrameOptions& options,
    const std::string& image_path,
    const std::function<void(const std::string&)>& log,
    const Scene& scene,
    const Estimate& estimate);

// The model of one frame whose cameras are `cameras` (id of a camera = index +
// 1), with their poses and intrinsics, after the refinement of its keypoints.
// image_paths: file of the image, by index of the camera; images without one
// keep their keypoints. `line`: for the log. On the CPU. Throws InputError for
// an image that cannot be read or has another size.
host::Reconstruction RefineKeypointsOfModel(
    const TrackRefinementOptions& options,
    const std::vector<RigCamera>& cameras,
    const std::map<size_t, std::string>& image_paths,
    const std::string& frame_name,
    host::Reconstruction reconstruction,
    std::string* line);

// The capture with the refined tracks in its models.
Capture ReplaceKeypoints(const KeypointRefinement& refinement, Capture capture);

}  // namespace mfir
