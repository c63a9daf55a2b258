// From reconstructions to the arrays of the refiner and back.

#include <algorithm>
#include <tuple>

#include "colmap_ext/frames/frames.h"
#include "colmap_ext/models/camera_models.h"
#include "src/geometry/alignment.h"
#include "src/parallel/parallel_for.h"
#include "src/util/errors.h"

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

void SetLenses(const FrameModel& model, std::vector<RigCamera>* cameras) {
  for (const auto& [camera_idx, image_id] : model.image_ids) {
    const host::Camera& camera = model.reconstruction->Camera(
        model.reconstruction->Image(image_id).CameraId());
    (*cameras)[camera_idx].model = FindCameraModel(host::ModelId(camera));
    (*cameras)[camera_idx].width = host::Width(camera);
    (*cameras)[camera_idx].height = host::Height(camera);
  }
}

void BuildFrame(const FrameModel& model,
                Frame* frame,
                FrameEstimate* estimate) {
  const host::Reconstruction& reconstruction = *model.reconstruction;
  frame->name = model.name;
  std::map<host::image_t, size_t> image_idxs;
  for (const auto& [camera_idx, image_id] : model.image_ids) {
    const host::Image& image = reconstruction.Image(image_id);
    image_idxs[image_id] = frame->images.size();
    frame->images.push_back({camera_idx, image.Name()});
    estimate->images.push_back(
        {host::CamFromWorld(image),
         host::Params(reconstruction.Camera(image.CameraId()))});
  }
  for (const host::point3D_t point_id : SortedPointIds(reconstruction)) {
    const host::Point3D& point = reconstruction.Point3D(point_id);
    estimate->points.push_back(host::Xyz(point));
    for (const host::TrackElement& element : host::TrackOf(point).Elements()) {
      const host::Image& image = reconstruction.Image(element.image_id);
      frame->observations.push_back(
          {image_idxs.at(element.image_id),
           host::Xy(image.Point2D(element.point2D_idx)),
           element.point2D_idx});
    }
    std::sort(frame->observations.begin() + frame->track_begins.back(),
              frame->observations.end(),
              IsBefore);
    frame->track_begins.push_back(frame->observations.size());
  }
}

// Of a camera, as a rank has seen it in its frames.
std::string DescribeLens(const RigCamera& camera) {
  if (camera.model == nullptr) return "";
  return camera.model->Name() + ", " + std::to_string(camera.width) + " x " +
         std::to_string(camera.height) + " pixels";
}

// Gives all ranks the lenses of cameras that only others have images of.
void ShareLenses(const Communicator& ranks, std::vector<RigCamera>* cameras) {
  if (ranks.IsAlone()) return;
  std::vector<std::string> names;
  std::vector<std::string> lenses;
  std::vector<size_t> sizes;
  for (const RigCamera& camera : *cameras) {
    names.push_back(camera.model == nullptr ? "" : camera.model->Name());
    lenses.push_back(DescribeLens(camera));
    sizes.push_back(camera.width);
    sizes.push_back(camera.height);
  }
  names = Concatenate(ranks, names);
  lenses = Concatenate(ranks, lenses);
  sizes = Concatenate(ranks, sizes);
  for (size_t i = 0; i < names.size(); ++i) {
    if (names[i].empty()) continue;
    RigCamera& camera = (*cameras)[i % cameras->size()];
    if (camera.model == nullptr) {
      camera.model = FindCameraModel(names[i]);
      camera.width = sizes[2 * i];
      camera.height = sizes[2 * i + 1];
    } else if (DescribeLens(camera) != lenses[i]) {
      throw InputError("Camera '" + camera.name + "' differs between frames: " +
                       DescribeLens(camera) + ", and " + lenses[i] +
                       ". Leave the frames of one kind out with "
                       "--frame_list_path, or convert all with "
                       "--MultiFrame.camera_model.");
    }
  }
}

}  // namespace

std::map<size_t, host::image_t> ImageIdsByCamera(
    const host::Reconstruction& reconstruction) {
  std::map<size_t, host::image_t> image_ids;
  for (const host::image_t image_id : reconstruction.RegImageIds()) {
    image_ids[reconstruction.Image(image_id).CameraId() - 1] = image_id;
  }
  return image_ids;
}

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
  result.scene.ranks = capture.ranks;
  std::vector<RigCamera>& cameras = result.scene.cameras;
  for (const KnownCamera& known : capture.cameras) {
    RigCamera& camera = cameras.emplace_back();
    camera.name = known.name;
    camera.cam_from_world =
        TransformPose(capture.new_from_rig, known.cam_from_world);
  }
  const std::vector<const FrameModel*> models = capture.UsedFrames();
  for (const FrameModel* model : models) SetLenses(*model, &cameras);
  result.scene.frames.resize(models.size());
  result.estimate.frames.resize(models.size());
  ParallelFor(models.size(), -1, [&](size_t i) {
    BuildFrame(*models[i], &result.scene.frames[i], &result.estimate.frames[i]);
  });
  ShareLenses(*capture.ranks, &cameras);
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
