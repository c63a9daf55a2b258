#include "colmap_ext/host/rig_model.h"

namespace mfir::host {

RigModel::RigModel(const std::vector<PosedCamera>& cameras)
    : rig_from_world_(cameras.front().cam_from_world) {
  for (const PosedCamera& camera : cameras) {
    cams_from_world_[CameraId(camera.camera)] = camera.cam_from_world;
    model_.AddCamera(camera.camera);
  }
}

void RigModel::AddImages(const std::vector<Image>& images) {
  for (const Image& image : images) {
    AddImageWithTrivialFrame(
        image, cams_from_world_.at(image.CameraId()), &model_);
  }
}

}  // namespace mfir::host
