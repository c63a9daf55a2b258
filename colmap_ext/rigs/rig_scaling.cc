#include "colmap_ext/rigs/rig_scaling.h"

#include <cmath>

namespace mfir {
namespace {

constexpr double kMaxRatioDifference = 1e-3;

bool HaveSameRatio(double width1,
                   double height1,
                   double width2,
                   double height2) {
  return std::abs(width1 * height2 / (width2 * height1) - 1.0) <=
         kMaxRatioDifference;
}

}  // namespace

bool ScaleToImageSize(size_t width, size_t height, KnownCamera* camera) {
  const double scale_x =
      static_cast<double>(width) / static_cast<double>(camera->width);
  const double scale_y =
      static_cast<double>(height) / static_cast<double>(camera->height);
  if (!HaveSameRatio(width, height, camera->width, camera->height)) {
    return false;
  }
  camera->width = width;
  camera->height = height;
  if (camera->model == nullptr) return true;
  const auto& focal_idxs = camera->model->FocalLengthIdxs();
  for (const size_t idx : focal_idxs) {
    camera->params[idx] *= focal_idxs.size() == 1 ? std::sqrt(scale_x * scale_y)
                           : idx == focal_idxs[0] ? scale_x
                                                  : scale_y;
  }
  // (0, 0) is a corner of the image in COLMAP's pixels, and stays one.
  camera->params[camera->model->PrincipalPointIdxs()[0]] *= scale_x;
  camera->params[camera->model->PrincipalPointIdxs()[1]] *= scale_y;
  return true;
}

std::string ImageSizeAdvice(size_t width,
                            size_t height,
                            size_t calibration_width,
                            size_t calibration_height) {
  if (width == calibration_height && height == calibration_width) {
    return "The sides are exchanged: the image, or those of the calibration, "
           "were rotated (portrait, EXIF orientation). Pixels are taken as "
           "they are stored: rotate the images back, or calibrate with such "
           "ones.";
  }
  if (HaveSameRatio(width, height, calibration_width, calibration_height)) {
    return "It is the same ratio: --MultiFrame.scale_intrinsics 1 takes the "
           "calibration at this resolution.";
  }
  return "Give the images of that resolution, or intrinsics of this one.";
}

}  // namespace mfir
