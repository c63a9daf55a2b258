// A camera of RIG as its file gives it.

#pragma once

#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "src/geometry/rigid3.h"
#include "src/sensor/camera_model.h"

namespace mfir {

// Every double is kept as it was read, but for quaternions, see
// StableQuaternion.
struct KnownCamera {
  std::string name;        // of the physical camera, see CameraNaming
  std::string image_name;  // of the file; the camera name where it has none
  Rigid3 cam_from_world;
  // [R | t] where the file gives a matrix (KRT, OpenCV): written back as it is.
  std::optional<Eigen::Matrix<double, 3, 4>> matrix;
  // Intrinsics: ground truth for the evaluator, used by the optimizer only on
  // request. Principal points in COLMAP pixels. model is null, width and height
  // are 0 where the file does not give them.
  const CameraModel* model = nullptr;
  size_t width = 0;
  size_t height = 0;
  std::vector<double> params;
};

// Lines for the log: what a file has that is not taken, or a format cannot
// hold.
using RigRemarks = std::vector<std::string>;

}  // namespace mfir
