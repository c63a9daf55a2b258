#include "colmap_ext/refinement/multi_frame_bundle_adjuster.h"

#include <map>
#include <memory>
#include <vector>

namespace mfir {
namespace {

host::BundleAdjustmentOptions HostOptions(const MultiFrameOptions& options) {
  return {options.refine_focal_length,
          options.refine_principal_point,
          options.refine_extra_params};
}

void SetEstimate(const Frame& frame,
                 const FrameEstimate& estimate,
                 const FrameModel& model,
                 host::Reconstruction* reconstruction) {
  for (size_t i = 0; i < frame.images.size(); ++i) {
    host::Image& image =
        reconstruction->Image(model.image_ids.at(frame.images[i].camera_idx));
    host::SetCamFromWorld(estimate.images[i].cam_from_world, &image);
    host::SetParams(estimate.images[i].params,
                    &reconstruction->Camera(image.CameraId()));
  }
  const std::vector<host::point3D_t> point_ids =
      SortedPointIds(*reconstruction);
  for (size_t i = 0; i < point_ids.size(); ++i) {
    host::Xyz(&reconstruction->Point3D(point_ids[i])) = estimate.points[i];
  }
}

FrameEstimate GetEstimate(const Frame& frame,
                          const FrameModel& model,
                          const host::Reconstruction& reconstruction) {
  FrameEstimate estimate;
  for (const FrameImage& frame_image : frame.images) {
    const host::Image& image =
        reconstruction.Image(model.image_ids.at(frame_image.camera_idx));
    estimate.images.push_back(
        {host::CamFromWorld(image),
         host::Params(reconstruction.Camera(image.CameraId()))});
  }
  for (const host::point3D_t point_id : SortedPointIds(reconstruction)) {
    estimate.points.push_back(host::Xyz(reconstruction.Point3D(point_id)));
  }
  return estimate;
}

}  // namespace

MultiFrameBundleAdjuster::MultiFrameBundleAdjuster(
    const MultiFrameOptions& options)
    : options_(options), adjuster_(HostOptions(options)) {}

Estimate MultiFrameBundleAdjuster::Run(const StageCallback& callback,
                                       const Capture& capture,
                                       const Scene& scene,
                                       Estimate estimate) {
  ProgressiveSchedule schedule(
      options_, scene.frames.size(), &estimate.cameras, adjuster_.Problem());
  for (size_t i = 0; i < scene.cameras.size(); ++i) {
    if (scene.cameras[i].constant_intrinsics) {
      adjuster_.SetConstantCamera(static_cast<host::camera_t>(i + 1));
    }
  }
  // COLMAP's residual blocks need a reconstruction that holds the variables.
  const std::vector<const FrameModel*> models = capture.UsedFrames();
  std::vector<std::unique_ptr<host::Reconstruction>> reconstructions;
  for (size_t f = 0; f < models.size(); ++f) {
    const FrameModel& model = *models[f];
    reconstructions.push_back(
        std::make_unique<host::Reconstruction>(*model.reconstruction));
    SetEstimate(scene.frames[f],
                estimate.frames[f],
                model,
                reconstructions.back().get());
    AddFrame(scene.frames[f], model, reconstructions.back().get(), &schedule);
  }
  schedule.Run(adjuster_.SolverOptions(), callback);
  adjuster_.UpdatePoses();
  for (size_t f = 0; f < models.size(); ++f) {
    estimate.frames[f] =
        GetEstimate(scene.frames[f], *models[f], *reconstructions[f]);
  }
  return estimate;
}

void MultiFrameBundleAdjuster::AddFrame(const Frame& scene_frame,
                                        const FrameModel& frame,
                                        host::Reconstruction* reconstruction,
                                        ProgressiveSchedule* schedule) {
  adjuster_.BeginReconstruction(reconstruction);
  ceres::LossFunction* loss =
      schedule->BeginFrame(scene_frame.observations.size());
  std::vector<ImageBlocks> images;
  for (const auto& [camera_idx, image_id] : frame.image_ids) {
    const host::BundleAdjuster::PoseBlocks pose =
        adjuster_.AddImage(image_id, loss);
    // An image without observations has no blocks in the problem.
    if (pose.rotation == nullptr) continue;
    images.push_back(
        {camera_idx,
         pose.rotation,
         pose.translation,
         host::ParamsData(reconstruction->Image(image_id).CameraId(),
                          reconstruction)});
  }
  adjuster_.EndReconstruction();
  std::vector<double*> points;
  for (const host::point3D_t point_id : SortedPointIds(*reconstruction)) {
    points.push_back(host::Xyz(&reconstruction->Point3D(point_id)).data());
  }
  schedule->EndFrame(images, points);
  if (scene_frame.cost_maps != nullptr) {
    AddFeaturemetric(scene_frame, images, reconstruction, schedule);
  }
}

void MultiFrameBundleAdjuster::AddFeaturemetric(
    const Frame& scene_frame,
    const std::vector<ImageBlocks>& images,
    host::Reconstruction* reconstruction,
    ProgressiveSchedule* schedule) {
  std::map<size_t, const ImageBlocks*> blocks_by_camera;
  for (const ImageBlocks& image : images) {
    blocks_by_camera[image.camera_idx] = &image;
  }
  const std::vector<host::point3D_t> point_ids =
      SortedPointIds(*reconstruction);
  for (size_t i = 0; i < point_ids.size(); ++i) {
    double* xyz = host::Xyz(&reconstruction->Point3D(point_ids[i])).data();
    for (size_t k = scene_frame.track_begins[i];
         k < scene_frame.track_begins[i + 1];
         ++k) {
      const Observation& observation = scene_frame.observations[k];
      if (observation.cost_map_idx < 0) continue;
      schedule->AddFeaturemetric(
          scene_frame.cost_maps,
          static_cast<size_t>(observation.cost_map_idx),
          *blocks_by_camera.at(
              scene_frame.images[observation.image_idx].camera_idx),
          xyz);
    }
  }
}

}  // namespace mfir
