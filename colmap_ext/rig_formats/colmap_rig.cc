#include "colmap_ext/host/reconstruction.h"
#include "colmap_ext/models/camera_models.h"
#include "colmap_ext/models/model_io.h"
#include "colmap_ext/rig_formats/camera_fields.h"
#include "colmap_ext/rig_formats/formats.h"

namespace mfir {

Cameras ReadColmapRig(const std::string& path,
                      double pixel_offset,
                      RigRemarks* /*remarks*/) {
  host::Reconstruction reconstruction;
  ReadModel(path, /*require_points=*/false, &reconstruction);
  Cameras cameras;
  for (const auto& [image_id, image] : reconstruction.Images()) {
    const host::Camera& colmap_camera = reconstruction.Camera(image.CameraId());
    KnownCamera camera;
    camera.image_name = image.Name();
    camera.cam_from_world = host::CamFromWorld(image);
    camera.model = FindCameraModel(host::ModelId(colmap_camera));
    camera.width = host::Width(colmap_camera);
    camera.height = host::Height(colmap_camera);
    camera.params = host::Params(colmap_camera);
    for (const size_t idx : camera.model->PrincipalPointIdxs()) {
      camera.params[idx] += pixel_offset;
    }
    cameras.push_back(std::move(camera));
  }
  return cameras;
}

void WriteColmapRig(const std::string& path,
                    const Cameras& cameras,
                    double pixel_offset,
                    RigRemarks* /*remarks*/) {
  host::Reconstruction reconstruction;
  for (size_t i = 0; i < cameras.size(); ++i) {
    const KnownCamera& camera = cameras[i];
    RequireIntrinsics("colmap", camera);
    RequireImageSize("colmap", camera);
    RigCamera posed{camera.name,
                    camera.cam_from_world,
                    camera.model,
                    camera.width,
                    camera.height,
                    camera.params};
    for (const size_t idx : camera.model->PrincipalPointIdxs()) {
      posed.params[idx] -= pixel_offset;
    }
    const auto id = static_cast<host::camera_t>(i + 1);
    AddPosedImage(id, WrittenImageName(camera), id, posed, &reconstruction);
  }
  WriteModel(path, /*with_text=*/true, reconstruction);
}

}  // namespace mfir
