#include "colmap_ext/host/camera.h"

#include "base/camera_models.h"

namespace mfir::host {

camera_t CameraId(const Camera& camera) { return camera.CameraId(); }

int ModelId(const Camera& camera) { return camera.ModelId(); }

size_t Width(const Camera& camera) { return camera.Width(); }

size_t Height(const Camera& camera) { return camera.Height(); }

const std::vector<double>& Params(const Camera& camera) {
  return camera.Params();
}

Eigen::Vector2d ImgFromCam(const Camera& camera,
                           const Eigen::Vector3d& cam_point) {
  return camera.WorldToImage(cam_point.hnormalized());
}

void SetParams(const std::vector<double>& params, Camera* camera) {
  camera->SetParams(params);
}

void SetModel(int model_id, const std::vector<double>& params, Camera* camera) {
  camera->SetModelId(model_id);
  camera->SetParams(params);
}

Camera MakeCamera(camera_t camera_id,
                  int model_id,
                  size_t width,
                  size_t height,
                  const std::vector<double>& params) {
  Camera camera;
  camera.SetCameraId(camera_id);
  camera.SetModelId(model_id);
  camera.SetWidth(width);
  camera.SetHeight(height);
  camera.SetParams(params);
  return camera;
}

void SetHasPriorFocalLength(bool has_prior_focal_length, Camera* camera) {
  camera->SetPriorFocalLength(has_prior_focal_length);
}

std::vector<double> InitialParams(int model_id,
                                  double focal_length,
                                  size_t width,
                                  size_t height) {
  return colmap::CameraModelInitializeParams(
      model_id, focal_length, width, height);
}

}  // namespace mfir::host
