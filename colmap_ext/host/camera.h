// COLMAP's cameras. A struct with public fields in COLMAP 4, a class in 3.8:
// fields are read through functions of the names they have in COLMAP 4.

#pragma once

#include <cstddef>
#include <vector>

#include <Eigen/Core>

#if MFIR_COLMAP_MAJOR >= 4
#include "colmap/scene/camera.h"
#else
#include "base/camera.h"
#endif

namespace mfir::host {

using colmap::Camera;
using colmap::camera_t;

camera_t CameraId(const Camera& camera);
int ModelId(const Camera& camera);
size_t Width(const Camera& camera);
size_t Height(const Camera& camera);
const std::vector<double>& Params(const Camera& camera);

// Pixel of a point in front of the camera.
Eigen::Vector2d ImgFromCam(const Camera& camera,
                           const Eigen::Vector3d& cam_point);

// The model stays: as many parameters as it has.
void SetParams(const std::vector<double>& params, Camera* camera);

// Changes model and parameters.
void SetModel(int model_id, const std::vector<double>& params, Camera* camera);

Camera MakeCamera(camera_t camera_id,
                  int model_id,
                  size_t width,
                  size_t height,
                  const std::vector<double>& params);

// For cameras that go to a database.
void SetHasPriorFocalLength(bool has_prior_focal_length, Camera* camera);

// COLMAP's guess: without distortion, principal point in the centre.
std::vector<double> InitialParams(int model_id,
                                  double focal_length,
                                  size_t width,
                                  size_t height);

}  // namespace mfir::host
