// The known extrinsics of a camera array (RIG): reading and writing.

#pragma once

#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "src/scene/scene.h"
#include "src/sensor/camera_naming.h"

namespace mfir {

// A camera of RIG as its file gives it. Every double is kept as it was read,
// but for quaternions, see StableQuaternion.
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

struct Rig {
  std::string format;  // "colmap", "krt" or "opencv"
  std::vector<KnownCamera> cameras;
};

// Reads RIG from `path`.
//
//   format        "colmap": model folder (images + cameras, .txt or .bin;
//                 points may be missing). "krt": Multiface KRT file. "opencv":
//                 folder with intri.yml + extri.yml (EasyMocap), or one of the
//                 two files. "" or "auto": detected from what lies at `path`.
//   pixel_offset  added to principal points of krt and opencv; NaN: 0 for krt
//                 and 0.5 for opencv. For colmap added too when not NaN.
//
// Distortion: KRT's five coefficients (k1 k2 p1 p2 k3) and OpenCV's dist become
// PINHOLE when all zero, OPENCV when k3 = 0, FULL_OPENCV otherwise.
//
// Cameras are in the order of their names (CameraNameLess). An image that the
// regex of `naming` does not match goes by its own name. intri.yml may be
// missing: the cameras then have no intrinsics.
//
// Throws UsageError for an unknown format, and InputError (names file and line
// or field) for: missing path, unreadable or malformed file, non-finite values,
// rotation that is not one (RtR differs from the identity by more than 1e-3 or
// det < 0), focal length <= 0, skew, the same camera twice, no camera at all.
Rig ReadRig(const std::string& path,
            const std::string& format,
            const CameraNaming& naming,
            double pixel_offset);

// Throws UsageError, naming `option`, for a value that cannot be an offset of
// principal points (NaN, the default of the format, can).
void CheckPixelOffset(const std::string& option, double pixel_offset);

// Writes a KRT file: blocks "name / K (3 rows) / distortion (k1 k2 p1 p2 k3) /
// [R|t] (3 rows) / empty line", %.17g. Cameras without model are an error in
// the caller. Models whose distortion KRT cannot hold (fisheye, FOV, thin
// prism, FULL_OPENCV with k4..k6) are written with their focal length and
// principal point and zero distortion; their names are returned so that the
// caller can say so. Throws OutputError.
std::vector<std::string> WriteKRT(const std::string& path,
                                  const std::vector<KnownCamera>& cameras);

}  // namespace mfir
