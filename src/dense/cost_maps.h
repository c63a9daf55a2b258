// From dense features to cost maps: what the featuremetric term needs of the
// features, and all that stays of them.

#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <string>

#include "cuda/cost_maps_gpu.h"
#include "src/dense/dense_features.h"
#include "src/scene/scene.h"

namespace mfir {

struct CostMapOptions {
  // COLMAP's meaning: 1: on a GPU, an error without one; 0: on the CPU; -1: on
  // a GPU if there is one.
  int use_gpu = -1;
  int gpu_index = -1;
  int num_threads = -1;
  // Cauchy scale of the robust mean of a track's features, relative to their
  // root mean square norm.
  double loss_scale = 0.25;
  // Patches of a frame are needed twice, for the references and for the cost
  // maps. Those up to this size stay in between, unless the source repeats
  // them cheaply; it is asked again for the others, one image at a time.
  size_t max_kept_bytes = size_t{1} << 30;
};

// Of one frame.
struct CostMapSummary {
  size_t num_observations = 0;
  size_t num_cost_maps = 0;
  // How often the source was asked for an image, and how long it took.
  size_t num_extractions = 0;
  double extraction_time_s = 0.0;
  double cost_map_time_s = 0.0;
  // "CPU" or name of the GPU.
  std::string device;
  // Why a GPU is not used; one line, in the first frame only, for the log.
  std::string fallback;
};

using CostMapCallback =
    std::function<void(size_t frame_idx, const CostMapSummary& summary)>;

using GpuCostMapBackendFactory = std::function<std::unique_ptr<CostMapBackend>(
    int gpu_index, int num_threads)>;

// The scene with the cost maps of all frames: for every track the reference
// feature (eq. "reference feature" of the paper), and for every observation the
// cost map of its patch (eq. "cost map"). An observation has none (cost_map_idx
// = -1) if the source has no feature for it, the feature is not finite, or the
// track has fewer than two features: alone, a feature says nothing.
//
// Peak memory beyond the cost maps (3 * 2 * patch_size^2 bytes per
// observation): of one frame 2 * num_channels bytes per observation, and its
// patches up to max_kept_bytes (none if the source repeats cheaply) or those of
// one image, whichever is more. A GPU that computes dense SIFT itself keeps
// images in its own memory instead of patches here.
//
// Throws InputError: an image or patches that cannot be used; UsageError:
// use_gpu = 1 without a GPU.
Scene ComputeCostMaps(
    const CostMapOptions& options,
    DenseFeatureSource* source,
    const CostMapCallback& callback,
    Scene scene,
    const GpuCostMapBackendFactory& make_gpu_backend = CreateGpuCostMapBackend);

}  // namespace mfir
