// The single formats behind ReadRig.

#pragma once

#include <string>
#include <vector>

#include <Eigen/Core>

#include "colmap_ext/rigs/rig_io.h"

namespace mfir {

// Cameras with image_name as the file names them; name is left empty. The
// offset is added to principal points. Throw InputError.
std::vector<KnownCamera> ReadKRTCameras(const std::string& path,
                                        double pixel_offset);
// `path`: folder with extri.yml and, if intrinsics are known, intri.yml; or one
// of the two; or another .yml file that holds both.
std::vector<KnownCamera> ReadOpenCVCameras(const std::string& path,
                                           double pixel_offset);

// Whether `path` is a folder or file that ReadOpenCVCameras takes.
bool IsOpenCVRig(const std::string& path);

// Sets matrix and cam_from_world from [R | t]. `where` begins the message of
// the InputError for values that are not finite and for R that is no rotation.
void SetPose(const Eigen::Matrix<double, 3, 4>& matrix,
             const std::string& where,
             KnownCamera* camera);

// Sets model and params from the 3x3 matrix K and OpenCV's distortion
// coefficients (k1 k2 p1 p2 k3 k4 k5 k6, or the first of them). Throws
// InputError for values that no camera model can hold.
void SetIntrinsics(const Eigen::Matrix3d& K,
                   const std::vector<double>& distortion,
                   double pixel_offset,
                   const std::string& where,
                   KnownCamera* camera);

}  // namespace mfir
