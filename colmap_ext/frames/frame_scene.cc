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

std::vector<host::point3D_t> SortedPointIds(
    const host::Reconstruction& reconstruction) {
  std::vector<host::point3D_t> ids;
  for (const auto& id_and_point : reconstruction.Points3D()) {
    ids.push_back(id_and_point.first);
  }
  std::sort(ids.begin(), ids.end());
  return ids;
}

SceneEstimate BuildScene(const Capture& capture) {
  SceneEstimate result;
  std::vector<RigCamera>& cameras = result.scene.cameras;
  for (const KnownCamera& known : capture.cameras) {
    RigCamera& camera = cameras.emplace_back();
    camera.name = known.name;
    camera.cam_from_world =
        TransformPose(capture.new_from_rig, known.cam_from_world);
  }
  for (const FrameModel& model : capture.frames) {
    if (!model.skip_reason.empty()) continue;
    const host::Reconstruction& reconstruction = *model.reconstruction;
    Frame& frame = result.scene.frames.emplace_back();
    FrameEstimate& estimate = result.estimate.frames.emplace_back();
    frame.name = model.name;
    std::map<host::image_t, size_t> image_idxs;
    for (const auto& [camera_idx, image_id] : model.image_ids) {
      const host::Image& image = reconstruction.Image(image_id);
      const host::Camera& camera = reconstruction.Camera(image.CameraId());
      cameras[camera_idx].model = FindCameraModel(host::ModelId(camera));
      cameras[camera_idx].width = host::Width(camera);
      cameras[camera_idx].height = host::Height(camera);
      image_idxs[image_id] = frame.images.size();
      frame.images.push_back({camera_idx, image.Name()});
      estimate.images.push_back(
          {host::CamFromWorld(image), host::Params(camera)});
    }
    for (const host::point3D_t point_id : SortedPointIds(reconstruction)) {
      const host::Point3D& point = reconstruction.Point3D(point_id);
      estimate.points.push_back(host::Xyz(point));
      for (const host::TrackElement& element :
           host::TrackOf(point).Elements()) {
        const host::Image& image = reconstruction.Image(element.image_id);
        frame.observations.push_back(
            {image_idxs.at(element.image_id),
             host::Xy(image.Point2D(element.point2D_idx)),
             element.point2D_idx});
      }
      std::sort(frame.observations.begin() + frame.track_begins.back(),
                frame.observations.end(),
                IsBefore);
      frame.track_begins.push_back(frame.observations.size());
    }
  }
  result.estimate.cameras = cameras;
  return result;
}

host::Reconstruction RefinedReconstruction(
    const Similarity3& rig_from_new,
    const FrameModel& model,
    const Scene& scene,
    const Estimate& estimate,
    size_t frame_idx,
    const std::vector<KnownCamera>& cameras,
    bool single_frame_mode) {
  host::Reconstruction reconstruction = *model.reconstruction;
  const Frame& frame = scene.frames[frame_idx];
  const FrameEstimate& frame_estimate = estimate.frames[frame_idx];
  std::vector<const std::vector<double>*> params;  // by image
  for (size_t i = 0; i < frame.images.size(); ++i) {
    const size_t camera_idx = frame.images[i].camera_idx;
    params.push_back(single_frame_mode ? &frame_estimate.images[i].params
                                       : &estimate.cameras[camera_idx].params);
    host::Image& image = reconstruction.Image(model.image_ids.at(camera_idx));
    host::SetCamFromWorld(cameras[camera_idx].cam_from_world, &image);
    host::SetParams(*params.back(), &reconstruction.Camera(image.CameraId()));
  }
  const std::vector<host::point3D_t> point_ids = SortedPointIds(reconstruction);
  for (size_t i = 0; i < point_ids.size(); ++i) {
    const Eigen::Vector3d& xyz = frame_estimate.points[i];
    double error_sum = 0.0;
    for (size_t k = frame.track_begins[i]; k < frame.track_begins[i + 1]; ++k) {
      const Observation& observation = frame.observations[k];
      const RigCamera& camera =
          estimate.cameras[frame.images[observation.image_idx].camera_idx];
      const Eigen::Vector3d p = camera.cam_from_world * xyz;
      Eigen::Vector2d xy;
      camera.model->Project(params[observation.image_idx]->data(),
                            p.x() / p.z(),
                            p.y() / p.z(),
                            xy.data());
      error_sum += (xy - observation.xy).norm();
    }
    host::Point3D& point = reconstruction.Point3D(point_ids[i]);
    host::Xyz(&point) = rig_from_new * xyz;
    host::SetError(error_sum / static_cast<double>(frame.track_begins[i + 1] -
                                                   frame.track_begins[i]),
                   &point);
  }
  return reconstruction;
}

}  // namespace mfir
