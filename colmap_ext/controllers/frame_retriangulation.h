// New tracks for frames that have a database, once the intrinsics are better
// known than when the frames were made.

#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "colmap_ext/frames/frames.h"
#include "colmap_ext/options/triangulator_options.h"
#include "src/refinement/options.h"
#include "src/scene/estimate.h"
#include "src/scene/scene.h"

namespace mfir {

// New tracks for the used frames of a capture.
struct Retriangulation {
  // By used frame; null: the frame keeps its tracks.
  std::vector<std::unique_ptr<host::Reconstruction>> models;
  // Why a frame with a database keeps its tracks; empty for the others.
  std::vector<std::string> failures;
  size_t num_frames = 0;  // with new tracks
  // Of all frames; these counts and the tolerance are those of all ranks.
  size_t num_points = 0;
  size_t num_observations = 0;
  // Epipolar tolerance, pixels: median over the frames with new tracks.
  double tolerance_px = 0.0;
};

// Makes the tracks of every used frame with a database anew, from its matches,
// as multi_frame_triangulator does with `track_options`: with the extrinsics
// and intrinsics of the estimate (in single-frame mode those of the
// frame), and thresholds that follow from the epipolar errors which these
// leave. Matches that came verified are verified again. Databases are only
// read, from copies in `work_path`, which are removed.
//
// A frame keeps its tracks if its database is not usable: damaged, images or
// keypoints other than those of the model, or less than half as many
// observations as the frame has. Throws OutputError.
Retriangulation RetriangulateFrames(const MultiFrameOptions& options,
                                    const TriangulatorOptions& track_options,
                                    const std::filesystem::path& work_path,
                                    const Capture& capture,
                                    const Scene& scene,
                                    const Estimate& estimate);

// The capture with the new models.
Capture ReplaceModels(Retriangulation retriangulation, Capture capture);

// The scene of a capture with new models, and where to start from: frames
// without a new model stay as they are in `previous`, and so do the cameras.
SceneEstimate WithNewTracks(const Capture& capture,
                            const std::vector<bool>& is_new,
                            SceneEstimate previous);

}  // namespace mfir
