// What a refinement has found out, and what it says of the cameras.

#pragma once

#include <optional>
#include <string>
#include <vector>

#include "colmap_ext/frames/frames.h"
#include "colmap_ext/refinement/refiner_solves.h"
#include "src/evaluation/drift_check.h"
#include "src/evaluation/extrinsics_check.h"
#include "src/selection/static_points.h"

namespace mfir {

struct RefinerResult {
  // "converged", "not_converged" or "contradicting_extrinsics".
  std::string status;
  // By camera: refined intrinsics and, with soft extrinsics, corrected poses,
  // in the coordinates of RIG.
  std::vector<KnownCamera> cameras;
  bool soft_extrinsics = false;
  bool single_frame_mode = false;
  Similarity3 rig_from_normalized;
  RefinedTracks refined;
  StaticPointStatistics static_points;
  // By camera: changes since the start, and since the intrinsics of RIG.
  std::vector<std::optional<CameraDrift>> drifts;
  std::vector<std::optional<CameraDrift>> drifts_from_rig;
  std::vector<PoseDisagreement> pose_disagreements;
  Contradictions contradictions;
  SpoiltCameras spoilt;
  double max_inlier_px = 0.0;         // see MaxInlierSquaredResidual
  std::vector<double> rms_px_before;  // see RmsByCamera
  std::vector<double> rms_px_after;
};

// Compares the refined tracks with the start and with RIG.
RefinerResult CheckResult(const MultiFrameOptions& options,
                          const Start& start,
                          const Tracks& tracks,
                          const SelectedTracks& selected,
                          RefinedTracks refined);

// On stderr, also when quiet: cameras whose result is not what the user
// expects.
void WarnOfCameras(const RefinerResult& result);

// The line that sums up the result.
std::string DescribeResult(const RefinerResult& result);

// Throws SolverError with the cure. `path`: where the result is.
void ThrowUnlessConverged(const RefinerResult& result,
                          int max_num_iterations,
                          const std::string& path);

}  // namespace mfir
