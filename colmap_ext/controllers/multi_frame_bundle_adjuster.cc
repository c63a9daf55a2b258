#include "colmap_ext/controllers/multi_frame_bundle_adjuster.h"

#include <algorithm>
#include <map>

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

}  // namespace

MultiFrameBundleAdjuster::MultiFrameBundleAdjuster(
    const MultiFrameOptions& options)
    : colmap::BundleAdjuster(ColmapOptions(options),
                             colmap::BundleAdjustmentConfig()),
      multi_frame_options_(options) {}

void MultiFrameBundleAdjuster::Run(const StageCallback& callback,
                                   Capture* capture,
                                   Scene* scene) {
  problem_ = std::make_unique<ceres::Problem>();
  ProgressiveSchedule schedule(multi_frame_options_,
                               scene->frames.size(),
                               &scene->cameras,
                               problem_.get());
  for (size_t i = 0; i < scene->cameras.size(); ++i) {
    if (scene->cameras[i].constant_intrinsics) {
      config_.SetConstantCamera(static_cast<colmap::camera_t>(i + 1));
    }
  }
  size_t frame_idx = 0;
  for (FrameModel& frame : capture->frames) {
    if (!frame.skip_reason.empty()) continue;
    const Frame& scene_frame = scene->frames[frame_idx++];
    // Same start for held parameters in all frames, see InitializeIntrinsics.
    for (const FrameImage& image : scene_frame.images) {
      frame.reconstruction
          ->Camera(static_cast<colmap::camera_t>(image.camera_idx + 1))
          .SetParams(image.params);
    }
    AddFrame(scene_frame, &frame, &schedule);
  }
  schedule.Run(options_.solver_options, callback);
}

void MultiFrameBundleAdjuster::AddFrame(const Frame& scene_frame,
                                        FrameModel* frame,
                                        ProgressiveSchedule* schedule) {
  colmap::Reconstruction* reconstruction = frame->reconstruction.get();
  camera_ids_.clear();
  point3D_num_observations_.clear();
  ceres::LossFunction* loss =
      schedule->BeginFrame(scene_frame.observations.size());
  std::vector<ImageBlocks> images;
  for (const auto& idx_and_image : frame->image_ids) {
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
