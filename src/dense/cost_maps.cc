#include "src/dense/cost_maps.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <optional>
#include <utility>

#include "cuda/cost_maps_gpu.h"
#include "src/dense/cost_map_backend.h"
#include "src/util/errors.h"
#include "src/util/gpu_choice.h"
#include "src/util/parallel_for.h"

namespace mfir {
namespace {

constexpr uint16_t kNanHalf = 0x7e00;

using Clock = std::chrono::steady_clock;

double SecondsSince(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

Eigen::Vector2d Origin(const DenseFeaturePatches& patches, size_t idx) {
  return patches.pixel_size *
         (patches.corners[idx].cast<double>() + Eigen::Vector2d(0.5, 0.5));
}

// Bicubic interpolation at an image position.
void InterpolateFeature(const DenseFeaturePatches& patches,
                        size_t idx,
                        const Eigen::Vector2d& xy,
                        uint16_t* feature) {
  const Eigen::Vector2d position =
      (xy - Origin(patches, idx)) / patches.pixel_size;
  const CubicWeights columns =
      MakeCubicWeights(position.x(), patches.patch_size);
  const CubicWeights rows = MakeCubicWeights(position.y(), patches.patch_size);
  const size_t num_channels = static_cast<size_t>(patches.num_channels);
  const uint16_t* patch =
      patches.data.data() + idx * patches.PatchNumElements();
  thread_local std::vector<float> sums;
  sums.assign(num_channels, 0.0f);
  for (int i = 0; i < 4; ++i) {
    for (int j = 0; j < 4; ++j) {
      const int pixel =
          (rows.begin + i) * patches.patch_size + columns.begin + j;
      const float weight =
          static_cast<float>(rows.weight[i] * columns.weight[j]);
      const uint16_t* values =
          patch + static_cast<size_t>(pixel) * num_channels;
      for (size_t c = 0; c < num_channels; ++c) {
        sums[c] += weight * HalfToFloat(values[c]);
      }
    }
  }
  for (size_t c = 0; c < num_channels; ++c) {
    feature[c] = FloatToClampedHalf(sums[c]);
  }
}

// The backend that the options ask for, and the CPU where a GPU fails.
class Backend {
 public:
  explicit Backend(const CostMapOptions& options)
      : cpu_(CreateCpuCostMapBackend(options.num_threads)),
        gpu_(options.use_gpu, "Cost maps are computed on the CPU", [&] {
          return CreateGpuCostMapBackend(options.gpu_index,
                                         options.num_threads);
        }) {}

  std::string Name() const { return Choose(gpu_.Get())->Name(); }
  std::string TakeFallback() { return gpu_.TakeFallback(); }

  // Calls function(backend), again on the CPU if a GPU fails.
  template <typename Function>
  void Call(const Function& function) {
    gpu_.Call([&](CostMapBackend* gpu) { function(Choose(gpu)); });
  }

 private:
  CostMapBackend* Choose(CostMapBackend* gpu) const {
    return gpu != nullptr ? gpu : cpu_.get();
  }

  const std::unique_ptr<CostMapBackend> cpu_;
  GpuChoice<CostMapBackend> gpu_;
};

// The cost maps of one frame.
class FrameCostMaps {
 public:
  FrameCostMaps(const CostMapOptions& options,
                DenseFeatureSource* source,
                Backend* backend,
                const Scene& scene,
                Frame* frame)
      : options_(options),
        source_(source),
        backend_(backend),
        scene_(scene),
        frame_(frame),
        observation_idxs_(frame->images.size()),
        kept_(frame->images.size()) {
    for (size_t k = 0; k < frame->observations.size(); ++k) {
      frame->observations[k].cost_map_idx = -1;
      if (frame->observations[k].keypoint_idx == kNoKeypoint) continue;
      observation_idxs_[frame->observations[k].image_idx].push_back(k);
    }
  }

  CostMapSummary Compute() {
    const Clock::time_point start = Clock::now();
    frame_->cost_maps = nullptr;
    for (size_t i = 0; i < frame_->images.size(); ++i) {
      InterpolateFeatures(i);
    }
    if (shape_) {
      FindReferences();
      ComputeMaps();
    }
    summary_.num_observations = frame_->observations.size();
    for (const Observation& observation : frame_->observations) {
      summary_.num_cost_maps += observation.cost_map_idx >= 0;
    }
    summary_.device = backend_->Name();
    summary_.fallback = backend_->TakeFallback();
    summary_.cost_map_time_s = SecondsSince(start) - summary_.extraction_time_s;
    return summary_;
  }

 private:
  DenseFeaturePatches Extract(size_t image_idx) {
    const Clock::time_point start = Clock::now();
    const FrameImage& image = frame_->images[image_idx];
    DenseFeatureRequest request;
    request.frame_name = frame_->name;
    request.camera_name = scene_.cameras[image.camera_idx].name;
    request.width = static_cast<int>(scene_.cameras[image.camera_idx].width);
    request.height = static_cast<int>(scene_.cameras[image.camera_idx].height);
    request.image_name = image.name;
    for (const size_t k : observation_idxs_[image_idx]) {
      request.keypoints.push_back(frame_->observations[k].xy);
      request.keypoint_ids.push_back(frame_->observations[k].keypoint_idx);
    }
    DenseFeaturePatches patches = source_->Extract(request);
    ++summary_.num_extractions;
    summary_.extraction_time_s += SecondsSince(start);
    Check(request, patches);
    return patches;
  }

  void Check(const DenseFeatureRequest& request,
             const DenseFeaturePatches& patches) {
    const size_t count = request.keypoints.size();
    const std::string name = "Dense features of frame '" + request.frame_name +
                             "', image '" + request.image_name + "': ";
    if (patches.valid.size() != count || patches.corners.size() != count ||
        patches.data.size() != count * patches.PatchNumElements()) {
      throw InputError(name + "not one patch per keypoint");
    }
    if (std::find(patches.valid.begin(), patches.valid.end(), true) ==
        patches.valid.end()) {
      return;
    }
    if (patches.patch_size < kMinPatchSize ||
        patches.patch_size > kMaxPatchSize) {
      throw InputError(name + "patch size " +
                       std::to_string(patches.patch_size) + "; it must be " +
                       std::to_string(kMinPatchSize) + " to " +
                       std::to_string(kMaxPatchSize));
    }
    if (patches.num_channels < 1 || !(patches.pixel_size > 0.0) ||
        !std::isfinite(patches.pixel_size)) {
      throw InputError(name + "no channels, or pixels without size");
    }
    const PatchShape shape = {patches.patch_size, patches.num_channels};
    if (shape_ && (shape.patch_size != shape_->patch_size ||
                   shape.num_channels != shape_->num_channels)) {
      throw InputError(name + std::to_string(shape.patch_size) +
                       " pixels and " + std::to_string(shape.num_channels) +
                       " channels, others of the " + "frame have " +
                       std::to_string(shape_->patch_size) + " and " +
                       std::to_string(shape_->num_channels));
    }
    if (!shape_) {
      shape_ = shape;
      features_.assign(
          frame_->observations.size() * static_cast<size_t>(shape.num_channels),
          kNanHalf);
    }
  }

  // The first pass over an image: features at its keypoints.
  void InterpolateFeatures(size_t image_idx) {
    const std::vector<size_t>& idxs = observation_idxs_[image_idx];
    if (idxs.empty()) return;
    DenseFeaturePatches patches = Extract(image_idx);
    ParallelFor(idxs.size(), options_.num_threads, [&](size_t i) {
      if (!patches.valid[i]) return;
      const size_t num_channels = static_cast<size_t>(patches.num_channels);
      uint16_t* feature = &features_[idxs[i] * num_channels];
      InterpolateFeature(patches, i, frame_->observations[idxs[i]].xy, feature);
      if (!std::all_of(feature, feature + num_channels, IsFiniteHalf)) {
        std::fill(feature, feature + num_channels, kNanHalf);
      }
    });
    const size_t bytes = patches.data.size() * sizeof(uint16_t);
    if (!source_->RepeatsCheaply() &&
        bytes <= options_.max_kept_bytes - kept_bytes_) {
      kept_bytes_ += bytes;
      kept_[image_idx] = std::move(patches);
    }
  }

  bool HasFeature(size_t observation_idx) const {
    return features_[observation_idx *
                     static_cast<size_t>(shape_->num_channels)] != kNanHalf;
  }

  void FindReferences() {
    const std::vector<int64_t> track_begins(frame_->track_begins.begin(),
                                            frame_->track_begins.end());
    std::vector<int64_t> track_references;
    backend_->Call([&](CostMapBackend* backend) {
      track_references =
          backend->FindReferences(features_,
                                  track_begins,
                                  shape_->num_channels,
                                  static_cast<float>(options_.loss_scale));
    });
    references_.assign(frame_->observations.size(), -1);
    for (size_t i = 0; i < track_references.size(); ++i) {
      const size_t begin = frame_->track_begins[i];
      const size_t end = frame_->track_begins[i + 1];
      size_t num_features = 0;
      for (size_t k = begin; k < end; ++k) num_features += HasFeature(k);
      if (num_features < 2) continue;
      for (size_t k = begin; k < end; ++k) {
        if (HasFeature(k)) references_[k] = track_references[i];
      }
    }
  }

  // The second pass.
  void ComputeMaps() {
    const size_t num_maps = static_cast<size_t>(
        std::count_if(references_.begin(), references_.end(), [](int64_t idx) {
          return idx >= 0;
        }));
    auto maps = std::make_shared<CostMaps>();
    maps->patch_size = shape_->patch_size;
    maps->placements.reserve(num_maps);
    maps->data.resize(num_maps * shape_->NumCostElements());
    for (size_t i = 0; i < frame_->images.size(); ++i) {
      ComputeMaps(i, maps.get());
    }
    frame_->cost_maps = std::move(maps);
  }

  void ComputeMaps(size_t image_idx, CostMaps* maps) {
    const std::vector<size_t>& idxs = observation_idxs_[image_idx];
    if (std::none_of(idxs.begin(), idxs.end(), [&](size_t k) {
          return references_[k] >= 0;
        })) {
      return;
    }
    DenseFeaturePatches patches = std::move(kept_[image_idx]);
    if (patches.data.empty()) patches = Extract(image_idx);
    std::vector<CostMapJob> jobs;
    std::vector<Observation*> observations;
    for (size_t i = 0; i < idxs.size(); ++i) {
      const int64_t reference = references_[idxs[i]];
      if (reference < 0 || !patches.valid[i]) continue;
      const size_t map_idx = maps->placements.size();
      maps->placements.push_back({Origin(patches, i), patches.pixel_size});
      jobs.push_back(
          {patches.data.data() + i * patches.PatchNumElements(),
           &features_[static_cast<size_t>(reference * shape_->num_channels)],
           &maps->data[map_idx * shape_->NumCostElements()]});
      observations.push_back(&frame_->observations[idxs[i]]);
      observations.back()->cost_map_idx = static_cast<int64_t>(map_idx);
    }
    backend_->Call([&](CostMapBackend* backend) {
      backend->ComputeMaps(
          *shape_, static_cast<float>(1.0 / patches.pixel_size), jobs);
    });
    for (size_t i = 0; i < jobs.size(); ++i) {
      const uint16_t* map = jobs[i].cost_map;
      if (!std::all_of(map, map + shape_->NumCostElements(), IsFiniteHalf)) {
        observations[i]->cost_map_idx = -1;
      }
    }
  }

  const CostMapOptions& options_;
  DenseFeatureSource* source_;
  Backend* backend_;
  const Scene& scene_;
  Frame* frame_;
  // By image, in the order of its keypoints.
  std::vector<std::vector<size_t>> observation_idxs_;
  std::vector<DenseFeaturePatches> kept_;
  size_t kept_bytes_ = 0;
  // Of all patches; known after the first valid one.
  std::optional<PatchShape> shape_;
  // By observation: the feature at the keypoint, NaN without; the observation
  // whose feature is the reference, -1 without a cost map.
  std::vector<uint16_t> features_;
  std::vector<int64_t> references_;
  CostMapSummary summary_;
};

}  // namespace

Scene ComputeCostMaps(const CostMapOptions& options,
                      DenseFeatureSource* source,
                      const CostMapCallback& callback,
                      Scene scene) {
  Backend backend(options);
  for (size_t i = 0; i < scene.frames.size(); ++i) {
    FrameCostMaps frame_cost_maps(
        options, source, &backend, scene, &scene.frames[i]);
    callback(i, frame_cost_maps.Compute());
  }
  return scene;
}

}  // namespace mfir
