#include "colmap_ext/refinement/multi_frame_bundle_adjuster.h"

#include <algorithm>
#include <map>
#include <memory>
#include <vector>

namespace mfir {
namespace {

colmap::BundleAdjustmentOptions ColmapOptions(
    const MultiFrameOptions& options) {
  colmap::BundleAdjustmentOptions colmap_options;
  colmap_options.refine_focal_length = options.refine_focal_length;
  colmap_options.refine_principal_point = options.refine_principal_point;
  colmap_options.refine_extra_params = options.refine_extra_params;
  return colmap_options;
}

void SetEstimate(const Frame& frame,
                 const FrameEstimate& estimate,
                 const FrameModel& model,
                 colmap::Reconstruction* reconstruction) {
  for (size_t i = 0; i < frame.images.size(); ++i) {
    colmap::Image& image =
        reconstruction->Image(model.image_ids.at(frame.images[i].camera_idx));
    SetCamFromWorld(estimate.images[i].cam_from_world, &image);
    reconstruction->Camera(image.CameraId())
        .SetParams(estimate.images[i].params);
  }
  const std::vector<colmap::point3D_t> point_ids =
      SortedPointIds(*reconstruction);
  for (size_t i = 0; i < point_ids.size(); ++i) {
    reconstruction->Point3D(point_ids[i]).SetXYZ(estimate.points[i]);
  }
}

FrameEstimate GetEstimate(const Frame& frame,
                          const FrameModel& model,
                          const colmap::Reconstruction& reconstruction) {
  FrameEstimate estimate;
  for (const FrameImage& frame_image : frame.images) {
    const colmap::Image& image =
        reconstruction.Image(model.image_ids.at(frame_image.camera_idx));
    estimate.images.push_back(
        {CamFromWorld(image),
         reconstruction.Camera(image.CameraId()).Params()});
  }
  for (const colmap::point3D_t point_id : SortedPointIds(reconstruction)) {
    estimate.points.push_back(reconstruction.Point3D(point_id).XYZ());
  }
  return estimate;
}

}  // namespace

MultiFrameBundleAdjuster::MultiFrameBundleAdjuster(
    const MultiFrameOptions& options)
    : colmap::BundleAdjuster(ColmapOptions(options),
                             colmap::BundleAdjustmentConfig()),
      multi_frame_options_(options) {}

Estimate MultiFrameBundleAdjuster::Run(const StageCallback& callback,
                                       const Capture& capture,
                                       const Scene& scene,
                                       Estimate estimate) {
  problem_ = std::make_unique<ceres::Problem>();
  ProgressiveSchedule schedule(multi_frame_options_,
                               scene.frames.size(),
                               &estimate.cameras,
                               problem_.get());
  for (size_t i = 0; i < scene.cameras.size(); ++i) {
    if (scene.cameras[i].constant_intrinsics) {
      config_.SetConstantCamera(static_cast<colmap::camera_t>(i + 1));
    }
  }
  // COLMAP's residual blocks need a reconstruction that holds the variables.
  std::vector<const FrameModel*> models;
  std::vector<std::unique_ptr<colmap::Reconstruction>> reconstructions;
  for (const FrameModel& model : capture.frames) {
    if (!model.skip_reason.empty()) continue;
    const size_t f = models.size();
    models.push_back(&model);
    reconstructions.push_back(
        std::make_unique<colmap::Reconstruction>(*model.reconstruction));
    SetEstimate(scene.frames[f],
                estimate.frames[f],
                model,
                reconstructions.back().get());
    AddFrame(scene.frames[f], model, reconstructions.back().get(), &schedule);
  }
  schedule.Run(options_.solver_options, callback);
  for (size_t f = 0; f < models.size(); ++f) {
    estimate.frames[f] =
        GetEstimate(scene.frames[f], *models[f], *reconstructions[f]);
  }
  return estimate;
}

void MultiFrameBundleAdjuster::AddFrame(const Frame& scene_frame,
                                        const FrameModel& frame,
                                        colmap::Reconstruction* reconstruction,
                                        ProgressiveSchedule* schedule) {
  camera_ids_.clear();
  point3D_num_observations_.clear();
  ceres::LossFunction* loss =
      schedule->BeginFrame(scene_frame.observations.size());
  std::vector<ImageBlocks> images;
  for (const auto& idx_and_image : frame.image_ids) {
    AddImageToProblem(idx_and_image.second, reconstruction, loss);
    colmap::Image& image = reconstruction->Image(idx_and_image.second);
    // An image without observations has no blocks in the problem.
    if (camera_ids_.count(image.CameraId()) > 0) {
      images.push_back({idx_and_image.first,
                        image.Qvec().data(),
                        image.Tvec().data(),
                        reconstruction->Camera(image.CameraId()).ParamsData()});
    }
  }
  ParameterizeCameras(reconstruction);

  std::vector<colmap::point3D_t> point_ids;
  for (const auto& id_and_count : point3D_num_observations_) {
    point_ids.push_back(id_and_count.first);
  }
  std::sort(point_ids.begin(), point_ids.end());
  std::vector<double*> points;
  for (const colmap::point3D_t point_id : point_ids) {
    points.push_back(reconstruction->Point3D(point_id).XYZ().data());
  }
  schedule->EndFrame(images, points);
  if (scene_frame.cost_maps != nullptr) {
    AddFeaturemetric(scene_frame, images, reconstruction, schedule);
  }
}

void MultiFrameBundleAdjuster::AddFeaturemetric(
    const Frame& scene_frame,
    const std::vector<ImageBlocks>& images,
    colmap::Reconstruction* reconstruction,
    ProgressiveSchedule* schedule) {
  std::map<size_t, const ImageBlocks*> blocks_by_camera;
  for (const ImageBlocks& image : images) {
    blocks_by_camera[image.camera_idx] = &image;
  }
  const std::vector<colmap::point3D_t> point_ids =
      SortedPointIds(*reconstruction);
  for (size_t i = 0; i < point_ids.size(); ++i) {
    double* xyz = reconstruction->Point3D(point_ids[i]).XYZ().data();
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
