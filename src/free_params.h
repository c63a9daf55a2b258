// What is free in the solve with (nearly) fixed extrinsics, and its priors.

#pragma once

#include <vector>

#include <Eigen/Core>

#include "fixed_extrinsics_solver.h"
#include "linearization.h"
#include "scene.h"

namespace mfir {

// A free parameter of a camera.
struct FreeParam {
  enum Type { kFocalLength, kPrincipalPoint, kExtra, kRotation, kCenter };
  Type type;
  size_t camera_idx;
  size_t idx;           // into the intrinsics, or axis of the correction
  double pixels;        // by which a unit moves the image, about
  double focal_length;  // of its camera
  double prior_std;     // 0: no prior
};

// Pixels by which a unit of each distortion coefficient moves the image corner;
// 1 for the other intrinsics.
std::vector<double> PixelScales(const RigCamera& camera);

// The free parameters of a camera, in the order of FreeParams.
std::vector<FreeParam> FreeParamsOfCamera(const FixedExtrinsicsOptions& options,
                                          const Scene& scene,
                                          size_t camera_idx);

FreeParams ToFreeParams(const std::vector<FreeParam>& camera_params);

// (parameter - known) / std of all priors, by free parameter; 0 without.
Eigen::VectorXd PriorResiduals(const std::vector<FreeParam>& params,
                               const Scene& scene,
                               const std::vector<CameraState>& states);

// Applies a rotation vector (rad) after the present rotation and shifts the
// camera centre.
void MovePose(const Eigen::Vector3d& rotation,
              const Eigen::Vector3d& center_shift,
              CameraState* state);

}  // namespace mfir
