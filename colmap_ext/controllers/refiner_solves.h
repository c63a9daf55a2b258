// The solves of the refiner, and the new tracks between them.

#pragma once

#include <filesystem>
#include <optional>
#include <vector>

#include "colmap_ext/controllers/refiner_progress.h"
#include "colmap_ext/frames/frames.h"
#include "colmap_ext/options/triangulator_options.h"
#include "src/evaluation/extrinsics_check.h"
#include "src/refinement/options.h"
#include "src/refinement/refinement.h"
#include "src/refinement/stage.h"
#include "src/scene/scene.h"

namespace mfir {

// Standard deviations of the residuals by camera, see extrinsics_check.h.
struct StartResiduals {
  std::vector<double> stds_px;
  std::vector<double> own_stds_px;
};

StartResiduals EvaluateStart(const MultiFrameOptions& options,
                             const Scene& start);

// Finds cameras whose extrinsics contradict the residuals of a solved scene
// (RobustStdByCamera), and adds them to the capture. What the tracks of the
// frames as given have shown stays: new tracks that fit the known extrinsics
// cannot contradict them.
std::vector<ExtrinsicsContradiction> AddContradictions(
    const Scene& scene,
    const StartResiduals& start,
    const std::vector<double>& stds_px,
    Capture* capture);

// Solves the scene: with a schedule first if the options have one.
RefinementResult RefineScene(const MultiFrameOptions& options,
                             const Similarity3& normalized_from_rig,
                             const StageCallback& callback,
                             Capture* capture,
                             Scene* scene);

struct RoundsResult {
  bool has_new_tracks = false;
  // Of the scene, if it is solved (with keypoints alone) as it is.
  std::optional<RefinementResult> refinement;
};

// Solves with the keypoints alone, and makes the tracks of frames with a
// database anew with the intrinsics so far, in turn. Stops when new tracks are
// no improvement over those of the round before, which then stay: the epipolar
// tolerance does not fall and observations do not become more, both by 1 %.
// `work_path` is for temporary files.
RoundsResult RetriangulateInRounds(const MultiFrameOptions& options,
                                   const TriangulatorOptions& track_options,
                                   const Similarity3& normalized_from_rig,
                                   const std::filesystem::path& work_path,
                                   const StartResiduals& start,
                                   Progress* progress,
                                   std::vector<Stage>* stages,
                                   Capture* capture,
                                   Scene* scene);

// The scene as it is, but with other intrinsics (by camera).
Scene WithIntrinsics(const std::vector<std::vector<double>>& params,
                     const Scene& scene);

}  // namespace mfir
