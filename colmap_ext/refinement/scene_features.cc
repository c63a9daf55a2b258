#include "colmap_ext/refinement/scene_features.h"

#include <utility>
#include <vector>

#include "colmap_ext/feature/dense_feature_sources.h"
#include "colmap_ext/host/util.h"
#include "src/dense/cost_maps.h"
#include "src/dense/feature_keypoints.h"

namespace mfir {
namespace {

// All images, by name only.
std::vector<DenseFeatureRequest> AllImages(const Scene& scene) {
  std::vector<DenseFeatureRequest> requests;
  for (const Frame& frame : scene.frames) {
    for (const FrameImage& image : frame.images) {
      DenseFeatureRequest request;
      request.frame_name = frame.name;
      request.camera_name = scene.cameras[image.camera_idx].name;
      request.image_name = image.name;
      requests.push_back(request);
    }
  }
  return requests;
}

}  // namespace

Scene AddDenseFeatures(const MultiFrameOptions& options,
                       const std::string& image_path,
                       const std::function<void(const std::string&)>& log,
                       Scene scene) {
  if (options.dense_features == "none") return scene;
  const std::unique_ptr<DenseFeatureSource> source =
      MakeDenseFeatureSource(options, image_path, AllImages(scene), log);
  CostMapOptions cost_map_options;
  cost_map_options.use_gpu = options.use_gpu;
  cost_map_options.gpu_index = options.gpu_index;
  cost_map_options.num_threads = options.num_threads;
  std::vector<std::string> frame_names;
  for (const Frame& frame : scene.frames) frame_names.push_back(frame.name);
  scene = ComputeCostMaps(
      cost_map_options,
      source.get(),
      [&](size_t frame_idx, const CostMapSummary& summary) {
        if (!summary.fallback.empty()) log(summary.fallback);
        log(host::StringPrintf(
            "Frame '%s' (%zu / %zu): cost maps of %zu of %zu observations, "
            "features %.1f s, cost maps %.1f s (%s)",
            frame_names[frame_idx].c_str(),
            frame_idx + 1,
            frame_names.size(),
            summary.num_cost_maps,
            summary.num_observations,
            summary.extraction_time_s,
            summary.cost_map_time_s,
            summary.device.c_str()));
      },
      std::move(scene));
  source->Finish();
  if (options.loss_scale == 0.0) {
    scene =
        FindFeatureKeypoints(options.EffectiveNumThreads(), std::move(scene));
  }
  return scene;
}

}  // namespace mfir
