// The lens models the refiner works with, as an interface: COLMAP's own models
// stand behind it (colmap_ext/models/camera_models.h), so that there is no
// second set.

#pragma once

#include <cstddef>
#include <string>
#include <vector>

namespace mfir {

class CameraModel {
 public:
  virtual ~CameraModel() = default;

  // Name as in COLMAP's cameras.txt, e.g. "OPENCV".
  virtual const std::string& Name() const = 0;
  virtual size_t NumParams() const = 0;

  // Indices into the parameter vector. One focal index: fx = fy.
  virtual const std::vector<size_t>& FocalLengthIdxs() const = 0;
  virtual const std::vector<size_t>& PrincipalPointIdxs() const = 0;
  virtual const std::vector<size_t>& ExtraParamsIdxs() const = 0;

  // Pixel coordinates `xy` (COLMAP's convention: the centre of the top-left
  // pixel is (0.5, 0.5)) of the camera ray (u, v, 1).
  virtual void Project(const double* params,
                       double u,
                       double v,
                       double* xy) const = 0;

  // The same with derivatives: `jacobian_uv` is the row-major 2x2 d(xy)/d(uv),
  // `jacobian_params` the row-major 2xNumParams() d(xy)/d(params).
  virtual void ProjectWithJacobian(const double* params,
                                   double u,
                                   double v,
                                   double* xy,
                                   double* jacobian_uv,
                                   double* jacobian_params) const = 0;

  // Ray (u, v, 1) of a pixel: the inverse of Project.
  virtual void Unproject(const double* params,
                         double x,
                         double y,
                         double* uv) const = 0;
};

}  // namespace mfir
