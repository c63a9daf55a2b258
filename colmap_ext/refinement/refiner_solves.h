// The solves of the refiner, and the new tracks between them.

#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "colmap_ext/controllers/keypoint_refinement.h"
#include "colmap_ext/frames/frames.h"
#include "colmap_ext/options/triangulator_options.h"
#include "colmap_ext/refinement/refiner_progress.h"
#include "src/evaluation/extrinsics_check.h"
#include "src/refinement/options.h"
#include "src/refinement/refinement.h"
#include "src/scene/estimate.h"
#include "src/scene/scene.h"
#include "src/selection/selection.h"
#include "src/selection/static_points.h"

namespace mfir {

// The frames as they were read.
struct Start {
  Scene scene;
  Estimate estimate;
  // Standard deviations of the residuals by camera, see extrinsics_check.h.
  std::vector<double> stds_px;
  std::vector<double> own_stds_px;
};

Start EvaluateStart(const MultiFrameOptions& options, SceneEstimate start);

// Why the extrinsics of a camera (by name) contradict the frames.
using Contradictions = std::map<std::string, std::string>;

Contradictions DescribeContradictions(
    const Scene& scene,
    const std::vector<ExtrinsicsContradiction>& contradictions);

// The tracks that are fitted, held out, merged and dropped.
struct SelectedTracks {
  Selection selection;
  StaticPointStatistics static_points;
};

SelectedTracks SelectTracks(const MultiFrameOptions& options,
                            const Scene& scene);

// Solves the scene: with a schedule first if the options have one. The capture
// is only read.
RefinementResult RefineScene(const MultiFrameOptions& options,
                             const StageCallback& callback,
                             const Capture& capture,
                             const Scene& scene,
                             Estimate start);

// The tracks that a refinement is to solve.
struct Tracks {
  Capture capture;
  Scene scene;
  Estimate estimate;
  bool are_new = false;  // made anew since the frames were read
  // Null: keypoints are as they were.
  std::optional<KeypointStatistics> keypoints;
  // Of the selected tracks, if they are solved (with keypoints alone) as they
  // are.
  std::optional<RefinementResult> refinement;
  // What tracks of the frames as given have shown: new tracks that fit the
  // known extrinsics cannot contradict them.
  Contradictions contradictions;
};

// Solves with the keypoints alone, and makes the tracks of frames with a
// database anew with the intrinsics so far, in turn. Stops when new tracks are
// no improvement over those of the round before, which then stay: the epipolar
// tolerance does not fall and observations do not become more, both by 1 %.
// `work_path` is for temporary files.
Tracks RetriangulateInRounds(const MultiFrameOptions& options,
                             const TriangulatorOptions& track_options,
                             const std::filesystem::path& work_path,
                             const Start& start,
                             Capture capture,
                             Progress* progress);

// Where the options ask for it, solves with the keypoints alone (unless that is
// done) and refines the keypoints of the tracks on the images
// (keypoint_refinement.h).
Tracks RefineKeypoints(const MultiFrameOptions& options,
                       const std::string& image_path,
                       const Start& start,
                       Tracks tracks,
                       Progress* progress);

// The refinement of the selected tracks with the points of all others.
struct RefinedTracks {
  Estimate estimate;             // of all tracks of the scene
  RefinementResult refinement;   // its estimate: of the selected tracks
  std::vector<bool> took_part;   // by camera: sees a track that was fitted
  double held_out_rms_px = 0.0;  // NaN: no tracks were held out
};

// Adds dense features to the selected tracks where the options ask for them,
// solves them, and intersects all others with the result.
RefinedTracks RefineTracks(const MultiFrameOptions& options,
                           const std::string& image_path,
                           const Tracks& tracks,
                           const Selection& selection,
                           Progress* progress);

// The estimate with the intrinsics that the scene starts from.
Estimate WithInitialIntrinsics(const Scene& scene, Estimate estimate);

}  // namespace mfir
