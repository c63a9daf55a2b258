// What rig formats have in common: checked poses and intrinsics.

#pragma once

#include <string>
#include <vector>

#include <Eigen/Core>

#include "colmap_ext/rig_formats/known_camera.h"

namespace mfir {

// Sets matrix and cam_from_world from [R | t]. `where` begins the message of
// the InputError for values that are not finite and for R that is no rotation.
void SetPose(const Eigen::Matrix<double, 3, 4>& matrix,
             const std::string& where,
             KnownCamera* camera);

// The same from [R | C] with x_world = R x_camera + C, camera axes as COLMAP's
// (x right, y down, z forward). matrix is not set.
void SetPoseFromWorldFromCam(const Eigen::Matrix<double, 3, 4>& world_from_cam,
                             const std::string& where,
                             KnownCamera* camera);

// [R | t] as the file gave it, else from the quaternion.
Eigen::Matrix<double, 3, 4> PoseMatrix(const KnownCamera& camera);

// [R | C] of the inverse.
Eigen::Matrix<double, 3, 4> WorldFromCamMatrix(const KnownCamera& camera);

// Sets model and params from the 3x3 matrix K and OpenCV's distortion
// coefficients (k1 k2 p1 p2 k3 k4 k5 k6, or the first of them). Throws
// InputError for values that no camera model can hold.
void SetIntrinsics(const Eigen::Matrix3d& K,
                   const std::vector<double>& distortion,
                   double pixel_offset,
                   const std::string& where,
                   KnownCamera* camera);

// Intrinsics by what the formats can write.
struct Lens {
  enum class Kind {
    kBrown,    // k1 k2 p1 p2 k3 k4 k5 k6, as FULL_OPENCV
    kFisheye,  // k1 k2 k3 k4, as OPENCV_FISHEYE
    kFov,      // omega, as FOV
    kOther,    // none
  };
  Kind kind = Kind::kBrown;
  double fx = 0.0;
  double fy = 0.0;
  double cx = 0.0;  // COLMAP pixels
  double cy = 0.0;
  std::vector<double> distortion;  // of the length above

  Eigen::Matrix3d K(double pixel_offset) const;
};

// Requires camera.model.
Lens LensOf(const KnownCamera& camera);

// Sets the smallest model that holds the lens: PINHOLE, OPENCV or FULL_OPENCV,
// OPENCV_FISHEYE, FOV. Coefficients may be fewer. Throws InputError.
void SetLens(const Lens& lens, const std::string& where, KnownCamera* camera);

// Distortion for a format that cannot hold every lens.
class LensFitter {
 public:
  // `format` is for messages. `max_num_brown`: coefficients of kBrown, 0 for
  // none. With fewer than 4, or without image size, what cannot be held is left
  // out; otherwise the closest OPENCV takes its place.
  LensFitter(const std::string& format,
             size_t max_num_brown,
             bool has_fisheye,
             bool has_fov = false);

  // kBrown with at least max_num_brown coefficients, of which those beyond are
  // 0; kFisheye or kFov where the format has it.
  Lens Fit(const KnownCamera& camera);

  // One line if a lens has changed.
  void AddRemarks(RigRemarks* remarks) const;

 private:
  const std::string format_;
  const size_t max_num_brown_;
  const bool has_fisheye_;
  const bool has_fov_;
  size_t num_fitted_ = 0;
  size_t num_left_out_ = 0;
  std::string first_;
  double max_error_ = 0.0;
};

// Throw InputError, naming the camera and what to do, where the format needs
// what the camera has not.
void RequireIntrinsics(const std::string& format, const KnownCamera& camera);
void RequireImageSize(const std::string& format, const KnownCamera& camera);

// The name of the camera for formats that name cameras: as its file writes it
// ("007"), where that is a name of the camera.
std::string WrittenName(const KnownCamera& camera);

// The same for formats that name images.
std::string WrittenImageName(const KnownCamera& camera);

// Writes a text file. Throws OutputError.
void WriteRigFile(const std::string& path, const std::string& text);

// %.17g, but independent of the locale.
std::string ExactNumber(double value);

}  // namespace mfir
