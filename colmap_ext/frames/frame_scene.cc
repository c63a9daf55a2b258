// From reconstructions to the arrays of the refiner and back.

#include <algorithm>
#include <tuple>

#include "colmap_ext/frames/frames.h"
#include "colmap_ext/io/camera_models.h"
#include "src/geometry/alignment.h"

namespace mfir {
namespace {

// An order that does not depend on that in the files.
bool IsBefore(const Observation& a, const Observation& b) {
  const auto key = [](const Observation& observation) {
    return std::make_tuple(
        observation.image_idx, observation.xy.x(), observation.xy.y());
  };
  return key(a) < key(b);
}

}  // namespace

std::vector<colmap::point3D_t> SortedPointIds(
    const colmap::Reconstruction& reconstruction) {
  std::vector<colmap::point3D_t> ids;
  for (const auto& id_and_point : reconstruction.Points3D()) {
    ids.push_back(id_and_point.first);
  }
  std::sort(ids.begin(), ids.end());
  return ids;
}

Scene BuildScene(const Similarity3& new_from_rig, const Capture& capture) {
  Scene scene;
  for (const KnownCamera& known : capture.cameras) {
    RigCamera camera;
    camera.name = known.name;
    camera.known_cam_from_world =
        TransformPose(new_from_rig, known.cam_from_world);
    camera.cam_from_world = camera.known_cam_from_world;
    scene.cameras.push_back(camera);
  }
  for (const FrameModel& model : capture.frames) {
    if (!model.skip_reason.empty()) continue;
    const colmap::Reconstruction& reconstruction = *model.reconstruction;
    Frame frame;
    frame.name = model.name;
    std::map<colmap::image_t, size_t> image_idxs;
    for (const auto& idx_and_image : model.image_ids) {
      const colmap::Image& image = reconstruction.Image(idx_and_image.second);
      const colmap::Camera& camera = reconstruction.Camera(image.CameraId());
      RigCamera& rig_camera = scene.cameras[idx_and_image.first];
      rig_camera.model = FindCameraModel(camera.ModelId());
      rig_camera.width = camera.Width();
      rig_camera.height = camera.Height();
      image_idxs[idx_and_image.second] = frame.images.size();
      frame.images.push_back({idx_and_image.first,
                              CamFromWorld(image),
                              camera.Params(),
                              image.Name()});
    }
    for (const colmap::point3D_t point_id : SortedPointIds(reconstruction)) {
      const colmap::Point3D& point = reconstruction.Point3D(point_id);
      frame.points.push_back(point.XYZ());
      for (const colmap::TrackElement& element : point.Track().Elements()) {
        frame.observations.push_back({image_idxs.at(element.image_id),
                                      reconstruction.Image(element.image_id)
                                          .Point2D(element.point2D_idx)
                                          .XY(),
                                      element.point2D_idx});
      }
      std::sort(frame.observations.begin() + frame.track_begins.back(),
                frame.observations.end(),
                IsBefore);
      frame.track_begins.push_back(frame.observations.size());
    }
    scene.frames.push_back(std::move(frame));
  }
  return scene;
}

void UpdateReconstructions(const Similarity3& new_from_rig,
                           const Scene& scene,
                           const std::vector<KnownCamera>& cameras,
                           bool single_frame_mode,
                           Capture* capture) {
  const Similarity3 rig_from_new = Inverse(new_from_rig);
  size_t frame_idx = 0;
  for (FrameModel& model : capture->frames) {
    if (!model.skip_reason.empty()) continue;
    const Frame& frame = scene.frames[frame_idx++];
    colmap::Reconstruction& reconstruction = *model.reconstruction;
    for (const FrameImage& frame_image : frame.images) {
      colmap::Image& image =
          reconstruction.Image(model.image_ids.at(frame_image.camera_idx));
      SetCamFromWorld(cameras[frame_image.camera_idx].cam_from_world, &image);
      reconstruction.Camera(image.CameraId())
          .SetParams(single_frame_mode
                         ? frame_image.params
                         : cameras[frame_image.camera_idx].params);
    }
    const std::vector<colmap::point3D_t> point_ids =
        SortedPointIds(reconstruction);
    for (size_t i = 0; i < point_ids.size(); ++i) {
      colmap::Point3D& point = reconstruction.Point3D(point_ids[i]);
      point.SetXYZ(rig_from_new * frame.points[i]);
      double error_sum = 0.0;
      for (size_t k = frame.track_begins[i]; k < frame.track_begins[i + 1];
           ++k) {
        const Observation& observation = frame.observations[k];
        const FrameImage& image = frame.images[observation.image_idx];
        const RigCamera& camera = scene.cameras[image.camera_idx];
        const Eigen::Vector3d p = camera.cam_from_world * frame.points[i];
        Eigen::Vector2d xy;
        camera.model->Project(
            single_frame_mode ? image.params.data() : camera.params.data(),
            p.x() / p.z(),
            p.y() / p.z(),
            xy.data());
        error_sum += (xy - observation.xy).norm();
      }
      point.SetError(error_sum / static_cast<double>(frame.track_begins[i + 1] -
                                                     frame.track_begins[i]));
    }
  }
}

}  // namespace mfir
