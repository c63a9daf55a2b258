// Captures with exact ground truth: a camera dome around a deforming, textured
// head, sparse models as structure from motion would give them, and images.

#pragma once

#include <functional>
#include <string>
#include <vector>

#include "colmap_ext/host/reconstruction.h"
#include "colmap_ext/options/simulator_options.h"
#include "src/scene/scene.h"
#include "src/simulation/image_renderer.h"

namespace mfir {

// In all models camera_id = image_id = index into the capture's cameras + 1,
// each image has its own camera, and images are named as the cameras,
// "cam00.png".
struct SimulatedFrame {
  std::string name;             // "frame000000"
  std::vector<bool> has_image;  // per camera; false: missing
  // Structure from motion: wrong intrinsics, noisy keypoints with outliers,
  // poses and points that fit them best, own gauge.
  host::Reconstruction sfm_model;
  Similarity3 sfm_from_rig;  // gauge of sfm_model
  // The same images, keypoints and tracks without any error, in rig
  // coordinates.
  host::Reconstruction true_model;
  size_t num_observations = 0;
  size_t num_outliers = 0;
};

struct SimulatedCapture {
  SimulatorOptions options;
  std::vector<RigCamera> true_cameras;
  // RIG: known extrinsics, drifted intrinsics.
  std::vector<RigCamera> known_cameras;
  std::vector<SimulatedFrame> frames;
};

// Simulates everything but the images. Throws UsageError, also when too few
// surface points are seen by options.min_views cameras.
SimulatedCapture SimulateCapture(const SimulatorOptions& options);

// The image of one frame and camera; a pure function of its arguments.
GreyImage RenderSimulatedImage(const SimulatedCapture& capture,
                               size_t frame_idx,
                               size_t camera_idx);

// The surface of a frame, in rig coordinates.
SyntheticSurface SimulatedSurface(const SimulatorOptions& options,
                                  size_t frame_idx);

// Throws OutputError if `output_path` exists and is not empty; with
// options.overwrite only if it is not a simulated capture.
void CheckSimulatorOutput(const SimulatorOptions& options,
                          const std::string& output_path);

// Writes below `output_path`
//
//   images/FRAME/camNN.png         8-bit grey
//   frames/FRAME/sparse/0/         sfm_model
//   rig/, KRT                      known_cameras; KRT where it can hold the
//   lens ground_truth/                  true_cameras ground_truth_frames/FRAME/
//   true_model, noise-free keypoints simulation.json                options and
//   totals
//
// `write_more` may add files to the folder it is given. The folder gets its
// name when it is complete. Throws OutputError when it cannot be written, or
// does not pass CheckSimulatorOutput.
void WriteSimulatedCapture(
    const SimulatedCapture& capture,
    const std::string& output_path,
    const std::function<void(const std::string&)>& write_more = {});

}  // namespace mfir
