#include "colmap_ext/host/rig_model.h"

#include "colmap_ext/host/v4/pose.h"

namespace mfir::host {
namespace {

constexpr colmap::rig_t kRigId = 1;

}  // namespace

RigModel::RigModel(const std::vector<PosedCamera>& cameras)
    : rig_from_world_(cameras.front().cam_from_world) {
  colmap::Rig rig;
  rig.SetRigId(kRigId);
  const colmap::Rigid3d world_from_rig =
      colmap::Inverse(ToColmap(rig_from_world_));
  for (const PosedCamera& camera : cameras) {
    cams_from_world_[CameraId(camera.camera)] = camera.cam_from_world;
    model_.AddCamera(camera.camera);
    if (rig.NumSensors() == 0) {
      rig.AddRefSensor(camera.camera.SensorId());
    } else {
      rig.AddSensor(camera.camera.SensorId(),
                    ToColmap(camera.cam_from_world) * world_from_rig);
    }
  }
  model_.AddRig(rig);
}

void RigModel::AddImages(const std::vector<Image>& images) {
  colmap::Frame frame;
  frame.SetFrameId(static_cast<colmap::frame_t>(model_.NumFrames() + 1));
  frame.SetRigId(kRigId);
  frame.SetRigFromWorld(ToColmap(rig_from_world_));
  for (const Image& image : images) frame.AddDataId(image.DataId());
  const colmap::frame_t frame_id = frame.FrameId();
  model_.AddFrame(frame);
  for (Image image : images) {
    image.SetFrameId(frame_id);
    model_.AddImage(std::move(image));
  }
}

}  // namespace mfir::host
