// Cameras whose known extrinsics contradict what they have seen.

#pragma once

#include <string>
#include <vector>

#include "src/scene/estimate.h"
#include "src/scene/scene.h"

namespace mfir {

// Standard deviation (px per axis) of Gaussian noise whose squared norms have
// the same median as the observations' squared residuals: one value per rig
// camera, NaN without observations. `squared_residuals` are in the order of
// the frames and their observations.
std::vector<double> RobustStdByCamera(
    const Scene& scene, const std::vector<double>& squared_residuals);

// Squared residual norms (px^2) under the poses, intrinsics and points of
// Estimate::frames; infinite for points behind the camera.
std::vector<double> OwnSquaredResiduals(const Scene& scene,
                                        const Estimate& estimate,
                                        int num_threads = -1);

// Cameras with fewer are not named as wrong: so few keypoints, some of them
// wrong, make any pose and contradict anything.
inline constexpr size_t kMinJudgedObservations = 30;

struct ExtrinsicsContradiction {
  size_t camera_idx = 0;
  double std_px = 0.0;         // under the known extrinsics, after refinement
  double others_std_px = 0.0;  // median of the cameras
  double own_std_px = 0.0;     // in the frames' own reconstructions
};

// Cameras whose residuals after the refinement (`stds_px`) are more than three
// times those of the other cameras, more than three times those in the frames'
// own reconstructions (`own_stds_px`: so it is not the keypoints), and above
// half a pixel. Where that holds for most cameras, because wrong ones have
// spoiled all, it is those whose residuals at the start (`start_stds_px`) were
// more than three times those of the others. All as RobustStdByCamera gives
// them.
std::vector<ExtrinsicsContradiction> FindExtrinsicsContradictions(
    const std::vector<double>& start_stds_px,
    const std::vector<double>& stds_px,
    const std::vector<double>& own_stds_px);

// How many of the cameras that do not contradict their extrinsics themselves
// have a worthless result.
struct SpoiltCameras {
  size_t num_spoilt = 0;
  size_t num_others = 0;  // with observations, not contradicting
  bool Most() const { return 2 * num_spoilt > num_others; }
};

// A camera is spoilt if a focal length has changed by more than a factor of two
// from its start in the scene, or if its residuals are more than three
// times those in the frames' own reconstructions, and above half a pixel. In
// small arrays the others cannot outvote a wrong camera: then most are spoilt,
// whether or not the solve has converged.
SpoiltCameras CountSpoiltCameras(
    const Scene& scene,
    const Estimate& estimate,
    const std::vector<ExtrinsicsContradiction>& contradictions,
    const std::vector<double>& stds_px,
    const std::vector<double>& own_stds_px);

}  // namespace mfir
