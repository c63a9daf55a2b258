#include "colmap_ext/result/capture_model.h"

#include <filesystem>

#include "colmap_ext/models/camera_models.h"

namespace mfir {
namespace {

std::vector<host::RigModel::PosedCamera> PosedCameras(
    const std::vector<KnownCamera>& cameras) {
  std::vector<host::RigModel::PosedCamera> posed;
  for (const KnownCamera& camera : cameras) {
    posed.push_back(
        {host::MakeCamera(static_cast<host::camera_t>(posed.size() + 1),
                          CameraModelId(*camera.model),
                          camera.width,
                          camera.height,
                          camera.params),
         camera.cam_from_world});
  }
  return posed;
}

}  // namespace

CaptureModel::CaptureModel(const std::vector<KnownCamera>& cameras,
                           const std::string& image_path)
    : images_(image_path), model_(PosedCameras(cameras)) {}

void CaptureModel::AddFrame(const FrameModel& frame,
                            const host::Reconstruction& refined) {
  model_.AddFrame(
      [&](const host::Image& image) {
        std::string name = ImageName(frame, image.Name());
        image_names_.insert(name);
        return name;
      },
      refined);
}

std::string CaptureModel::ImageName(const FrameModel& frame,
                                    const std::string& name) const {
  if (frame.is_part_of_model) return name;
  DenseFeatureRequest request;
  request.frame_name = frame.name;
  request.image_name = name;
  const bool lies_beside_others =
      !images_.Path().empty() &&
      std::filesystem::path(images_.Find(request)) ==
          std::filesystem::path(images_.Path()) / name;
  return lies_beside_others && image_names_.count(name) == 0
             ? name
             : frame.name + "/" + name;
}

}  // namespace mfir
