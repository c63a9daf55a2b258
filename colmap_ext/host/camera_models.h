// COLMAP's lens models, which are classes of static templates, under the names
// of COLMAP 4.

#pragma once

#include <limits>
#include <string>
#include <vector>

#if MFIR_COLMAP_MAJOR >= 4
#include "colmap/sensor/models.h"
#else
#include "base/camera_models.h"
#endif

namespace mfir::host {

// What differs in a lens model. `Model` is one of COLMAP's classes.
template <typename Model>
struct CameraModelTraits {
#if MFIR_COLMAP_MAJOR >= 4
  static constexpr int kModelId = static_cast<int>(Model::model_id);
  static constexpr int kNumParams = Model::num_params;
#else
  static constexpr int kModelId = Model::kModelId;
  static constexpr int kNumParams = Model::kNumParams;
#endif

  static std::vector<size_t> FocalLengthIdxs() {
    return {Model::focal_length_idxs.begin(), Model::focal_length_idxs.end()};
  }
  static std::vector<size_t> PrincipalPointIdxs() {
    return {Model::principal_point_idxs.begin(),
            Model::principal_point_idxs.end()};
  }
  static std::vector<size_t> ExtraParamsIdxs() {
    return {Model::extra_params_idxs.begin(), Model::extra_params_idxs.end()};
  }

  // Names of the parameters, as "fx, fy, cx, cy".
  static std::string ParamsInfo() { return Model::params_info; }

  // Of the ray (u, v, 1). Not finite where the model ends.
  template <typename T>
  static void ImgFromCam(const T* params, const T& u, const T& v, T* x, T* y) {
#if MFIR_COLMAP_MAJOR >= 4
    // On the axis the division models differentiate a square root at zero.
    const T off_axis = u == T(0) && v == T(0) ? u + T(1e-150) : u;
    if (!Model::ImgFromCam(params, off_axis, v, T(1), x, y)) {
      *x = *y = T(std::numeric_limits<double>::quiet_NaN());
    }
#else
    Model::WorldToImage(params, u, v, x, y);
#endif
  }

  // Where the iterations do not converge the ray is the last one, or not
  // finite.
  static void CamFromImg(
      const double* params, double x, double y, double* u, double* v) {
#if MFIR_COLMAP_MAJOR >= 4
    *u = *v = std::numeric_limits<double>::quiet_NaN();
    (void)Model::CamFromImg(params, x, y, u, v);
#else
    Model::ImageToWorld(params, x, y, u, v);
#endif
  }
};

// Calls visit(Model{}) for all lens models with a focal length.
template <typename Visitor>
void VisitCameraModels(const Visitor& visit) {
  using namespace colmap;  // NOLINT: the list of cases is COLMAP's
#define CAMERA_MODEL_CASE(Model) visit(Model{});  // NOLINT: a type
#if MFIR_COLMAP_MAJOR >= 4
  PERSPECTIVE_CAMERA_MODEL_CASES
#else
  CAMERA_MODEL_CASES
#endif
#undef CAMERA_MODEL_CASE
}

}  // namespace mfir::host
