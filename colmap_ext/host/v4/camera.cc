#include "colmap_ext/host/camera.h"

namespace mfir::host {

camera_t CameraId(const Camera& camera) { return camera.camera_id; }

int ModelId(const Camera& camera) { return static_cast<int>(camera.model_id); }

size_t Width(const Camera& camera) { return camera.width; }

size_t Height(const Camera& camera) { return camera.height; }

const std::vector<double>& Params(const Camera& camera) {
  return camera.params;
}

Eigen::Vector2d ImgFromCam(const Camera& camera,
                           const Eigen::Vector3d& cam_point) {
  return camera.ImgFromCam(cam_point).value();
}

void SetParams(const std::vector<double>& params, Camera* camera) {
  THROW_CHECK_EQ(params.size(), camera->params.size());
  camera->params = params;
}

void SetModel(int model_id, const std::vector<double>& params, Camera* camera) {
  camera->model_id = static_cast<colmap::CameraModelId>(model_id);
  camera->params = params;
}

Camera MakeCamera(camera_t camera_id,
                  int model_id,
                  size_t width,
                  size_t height,
                  const std::vector<double>& params) {
  Camera camera;
  camera.camera_id = camera_id;
  camera.width = width;
  camera.height = height;
  SetModel(model_id, params, &camera);
  return camera;
}

void SetHasPriorFocalLength(bool has_prior_focal_length, Camera* camera) {
  camera->has_prior_focal_length = has_prior_focal_length;
}

std::vector<double> InitialParams(int model_id,
                                  double focal_length,
                                  size_t width,
                                  size_t height) {
  return colmap::CameraModelInitializeParams(
      static_cast<colmap::CameraModelId>(model_id),
      focal_length,
      width,
      height);
}

}  // namespace mfir::host
