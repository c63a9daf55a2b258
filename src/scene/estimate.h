// What is solved for: a stage takes an estimate and returns a new one.

#pragma once

#include <cstddef>
#include <vector>

#include <Eigen/Core>

#include "src/geometry/rigid3.h"
#include "src/scene/scene.h"

namespace mfir {

// Of Frame::images[i]. Where all frames share the rig's poses and intrinsics,
// these stay what the frame's own reconstruction has.
struct ImageEstimate {
  Rigid3 cam_from_world;  // world = the frame's coordinates
  std::vector<double> params;
};

struct FrameEstimate {
  std::vector<ImageEstimate> images;    // as Frame::images
  std::vector<Eigen::Vector3d> points;  // as the tracks of the frame
};

struct Estimate {
  // As Scene::cameras: the same cameras with refined intrinsics and, where the
  // extrinsics are known with a standard deviation only, corrected poses.
  std::vector<RigCamera> cameras;
  std::vector<FrameEstimate> frames;  // as Scene::frames
};

// The rig's cameras with the intrinsics of the images that the frame has of
// them.
inline std::vector<RigCamera> FrameCameras(const Scene& scene,
                                           const Estimate& estimate,
                                           size_t frame_idx) {
  std::vector<RigCamera> cameras = estimate.cameras;
  const std::vector<FrameImage>& images = scene.frames[frame_idx].images;
  for (size_t i = 0; i < images.size(); ++i) {
    cameras[images[i].camera_idx].params =
        estimate.frames[frame_idx].images[i].params;
  }
  return cameras;
}

// Measurements and an estimate of what they have measured.
struct SceneEstimate {
  Scene scene;
  Estimate estimate;
};

}  // namespace mfir
