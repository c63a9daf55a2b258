// What is free in the solve with (nearly) fixed extrinsics, and its priors.

#pragma once

#include <vector>

#include <Eigen/Core>

#include "src/estimators/fixed_extrinsics_solver.h"
#include "src/residuals/linearization.h"
#include "src/scene/estimate.h"
#include "src/scene/scene.h"

namespace mfir {

// A free parameter of a camera.
struct FreeParam {
  enum Type { kFocalLength, kPrincipalPoint, kExtra, kRotation, kCenter };
  Type type;
  size_t camera_idx;
  size_t idx;            // into the intrinsics, or axis of the correction
  double pixels;         // by which a unit moves the image, about
  double focal_length;   // of its camera
  double prior_std;      // 0: no prior
  double plausible_std;  // how far from its start it may well be

  bool IsPose() const { return type == kRotation || type == kCenter; }
};

// Pixels by which a unit of each distortion coefficient moves the image corner;
// 1 for the other intrinsics.
std::vector<double> PixelScales(const RigCamera& camera);

// All free parameters, in the order of the reduced system.
struct ReducedParams {
  std::vector<FreeParam> params;
  // By camera: what is free, and where it starts.
  std::vector<FreeParams> by_camera;
  std::vector<Eigen::Index> offsets;

  Eigen::Index Size() const { return static_cast<Eigen::Index>(params.size()); }
  Eigen::Index SizeOf(size_t camera_idx) const {
    return static_cast<Eigen::Index>(by_camera[camera_idx].Size());
  }
};

// Of the cameras that are observed; nothing is free in the others. What
// parameters are worth in pixels is that of the estimate.
ReducedParams CollectFreeParams(const FixedExtrinsicsOptions& options,
                                const Scene& scene,
                                const Estimate& estimate,
                                const std::vector<bool>& observed);

// (parameter - known) / std of all priors, by free parameter; 0 without. Known
// are the cameras of the scene.
Eigen::VectorXd PriorResiduals(const std::vector<FreeParam>& params,
                               const Scene& scene,
                               const std::vector<CameraState>& states);

// States after a step of the free parameters.
std::vector<CameraState> AddStep(const ReducedParams& params,
                                 const Eigen::VectorXd& step,
                                 std::vector<CameraState> states);

}  // namespace mfir
