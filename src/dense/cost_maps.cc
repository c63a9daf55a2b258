#include "src/dense/cost_maps.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <optional>
#include <utility>

#include "src/dense/cost_map_backend.h"
#include "src/parallel/parallel_for.h"
#include "src/util/errors.h"
#include "src/util/gpu_choice.h"

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

// Of the pixels of a patch for bicubic interpolation at an image position.
void MakeWeights(const DenseFeaturePatches& patches,
                 size_t idx,
                 const Eigen::Vector2d& xy,
                 CubicWeights* columns,
                 CubicWeights* rows) {
  const Eigen::Vector2d position =
      (xy - Origin(patches, idx)) / patches.pixel_size;
  *columns = MakeCubicWeights(position.x(), patches.patch_size);
  *rows = MakeCubicWeights(position.y(), patches.patch_size);
}

// The feature at an image position.
void InterpolateFeature(const DenseFeaturePatches& patches,
                        size_t idx,
                        const Eigen::Vector2d& xy,
                        uint16_t* feature) {
  CubicWeights columns;
  CubicWeights rows;
  MakeWeights(patches, idx, xy, &columns, &rows);
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

// The same interpolation on a GPU.
DenseSiftKeypoint MakeDenseSiftKeypoint(const DenseFeaturePatches& patches,
                                        size_t idx,
                                        const Eigen::Vector2d& xy) {
  CubicWeights columns;
  CubicWeights rows;
  MakeWeights(patches, idx, xy, &columns, &rows);
  DenseSiftKeypoint keypoint;
  keypoint.corner = {patches.corners[idx].x() + columns.begin,
                     patches.corners[idx].y() + rows.begin};
  std::copy_n(columns.weight, 4, keypoint.column_weights);
  std::copy_n(rows.weight, 4, keypoint.row_weights);
  return keypoint;
}

// The patches of an image; instead of their data possibly the image on a GPU,
// which computes them there.
struct ImagePatches {
  DenseFeaturePatches patches;
  std::unique_ptr<DeviceSift> sift;

  size_t NumBytes() const {
    return sift ? sift->NumBytes() : patches.data.size() * sizeof(uint16_t);
  }
};

bool AnyValid(const DenseFeaturePatches& patches) {
  return std::find(patches.valid.begin(), patches.valid.end(), true) !=
         patches.valid.end();
}

// The backend that the options ask for, and the CPU where a GPU fails.
class Backend {
 public:
  Backend(const CostMapOptions& options,
          const GpuCostMapBackendFactory& make_gpu_backend)
      : cpu_(CreateCpuCostMapBackend(options.num_threads)),
        gpu_(options.use_gpu, "Cost maps are computed on the CPU", [&] {
          return make_gpu_backend(options.gpu_index, options.num_threads);
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
  ImagePatches Extract(size_t image_idx) {
    const Clock::time_point start = Clock::now();
    const DenseFeatureRequest request = MakeRequest(image_idx);
    ImagePatches image;
    backend_->Call(
        [&](CostMapBackend* backend) { image = Extract(request, backend); });
    ++summary_.num_extractions;
    summary_.extraction_time_s += SecondsSince(start);
    Check(request, image);
    return image;
  }

  ImagePatches Extract(const DenseFeatureRequest& request,
                       CostMapBackend* backend) {
    ImagePatches image;
    SiftImage sift_image;
    if (!backend->ComputesSift() ||
        !source_->ReadSiftImage(request, &sift_image, &image.patches)) {
      image.patches = source_->Extract(request);
    } else if (AnyValid(image.patches)) {
      image.sift = backend->LoadSift(sift_image);
    } else {
      image.patches = NoPatches(request);
    }
    return image;
  }

  // Calls function(backend), with patches from the source after a GPU failed.
  template <typename Function>
  void CallWithPatches(size_t image_idx,
                       ImagePatches* image,
                       const Function& function) {
    backend_->Call([&](CostMapBackend* backend) {
      if (image->sift && !backend->ComputesSift()) *image = Extract(image_idx);
      function(backend);
    });
  }

  DenseFeatureRequest MakeRequest(size_t image_idx) const {
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
    return request;
  }

  void Check(const DenseFeatureRequest& request, const ImagePatches& image) {
    const DenseFeaturePatches& patches = image.patches;
    const size_t count = request.keypoints.size();
    const std::string name = "Dense features of frame '" + request.frame_name +
                             "', image '" + request.image_name + "': ";
    if (patches.valid.size() != count || patches.corners.size() != count ||
        (!image.sift &&
         patches.data.size() != count * patches.PatchNumElements())) {
      throw InputError(name + "not one patch per keypoint");
    }
    if (!AnyValid(patches)) return;
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
    if (observation_idxs_[image_idx].empty()) return;
    ImagePatches image = Extract(image_idx);
    CallWithPatches(image_idx, &image, [&](CostMapBackend*) {
      if (image.sift) {
        InterpolateOnGpu(image_idx, image.patches, image.sift.get());
      } else {
        InterpolateOnCpu(image_idx, image.patches);
      }
    });
    const size_t bytes = image.NumBytes();
    if (!source_->RepeatsCheaply() &&
        bytes <= options_.max_kept_bytes - kept_bytes_) {
      kept_bytes_ += bytes;
      kept_[image_idx] = std::move(image);
    }
  }

  void InterpolateOnCpu(size_t image_idx, const DenseFeaturePatches& patches) {
    const std::vector<size_t>& idxs = observation_idxs_[image_idx];
    ParallelFor(idxs.size(), options_.num_threads, [&](size_t i) {
      if (!patches.valid[i]) return;
      const size_t num_channels = static_cast<size_t>(patches.num_channels);
      uint16_t* feature = &features_[idxs[i] * num_channels];
      InterpolateFeature(patches, i, frame_->observations[idxs[i]].xy, feature);
      if (!std::all_of(feature, feature + num_channels, IsFiniteHalf)) {
        std::fill(feature, feature + num_channels, kNanHalf);
      }
    });
  }

  void InterpolateOnGpu(size_t image_idx,
                        const DenseFeaturePatches& patches,
                        DeviceSift* sift) {
    const std::vector<size_t>& idxs = observation_idxs_[image_idx];
    std::vector<DenseSiftKeypoint> keypoints;
    std::vector<size_t> keypoint_idxs;
    for (size_t i = 0; i < idxs.size(); ++i) {
      if (!patches.valid[i]) continue;
      keypoint_idxs.push_back(idxs[i]);
      keypoints.push_back(
          MakeDenseSiftKeypoint(patches, i, frame_->observations[idxs[i]].xy));
    }
    const size_t num_channels = static_cast<size_t>(patches.num_channels);
    std::vector<uint16_t> features(keypoints.size() * num_channels);
    sift->Interpolate(keypoints, features.data());
    for (size_t k = 0; k < keypoints.size(); ++k) {
      std::copy_n(features.begin() + k * num_channels,
                  num_channels,
                  features_.begin() + keypoint_idxs[k] * num_channels);
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
    ImagePatches image =
        kept_[image_idx] ? std::move(*kept_[image_idx]) : Extract(image_idx);
    const DenseFeaturePatches& patches = image.patches;
    std::vector<size_t> patch_idxs;
    std::vector<CostMapJob> jobs;
    for (size_t i = 0; i < idxs.size(); ++i) {
      const int64_t reference = references_[idxs[i]];
      if (reference < 0 || !patches.valid[i]) continue;
      const size_t map_idx = maps->placements.size();
      maps->placements.push_back({Origin(patches, i), patches.pixel_size});
      patch_idxs.push_back(i);
      jobs.push_back(
          {nullptr,
           &features_[static_cast<size_t>(reference * shape_->num_channels)],
           &maps->data[map_idx * shape_->NumCostElements()]});
      frame_->observations[idxs[i]].cost_map_idx =
          static_cast<int64_t>(map_idx);
    }
    CallWithPatches(image_idx, &image, [&](CostMapBackend* backend) {
      ComputeMaps(image, patch_idxs, backend, &jobs);
    });
    for (size_t k = 0; k < jobs.size(); ++k) {
      const uint16_t* map = jobs[k].cost_map;
      if (!std::all_of(map, map + shape_->NumCostElements(), IsFiniteHalf)) {
        frame_->observations[idxs[patch_idxs[k]]].cost_map_idx = -1;
      }
    }
  }

  // Of these patches; the jobs know all but the patch.
  void ComputeMaps(const ImagePatches& image,
                   const std::vector<size_t>& patch_idxs,
                   CostMapBackend* backend,
                   std::vector<CostMapJob>* jobs) const {
    const DenseFeaturePatches& patches = image.patches;
    if (image.sift) {
      std::vector<SiftMapJob> sift_jobs;
      for (size_t k = 0; k < jobs->size(); ++k) {
        const Eigen::Vector2i& corner = patches.corners[patch_idxs[k]];
        sift_jobs.push_back({{corner.x(), corner.y()},
                             (*jobs)[k].reference,
                             (*jobs)[k].cost_map});
      }
      image.sift->ComputeMaps(shape_->patch_size, sift_jobs);
      return;
    }
    for (size_t k = 0; k < jobs->size(); ++k) {
      (*jobs)[k].patch =
          patches.data.data() + patch_idxs[k] * patches.PatchNumElements();
    }
    backend->ComputeMaps(
        *shape_, static_cast<float>(1.0 / patches.pixel_size), *jobs);
  }

  const CostMapOptions& options_;
  DenseFeatureSource* source_;
  Backend* backend_;
  const Scene& scene_;
  Frame* frame_;
  // By image, in the order of its keypoints.
  std::vector<std::vector<size_t>> observation_idxs_;
  std::vector<std::optional<ImagePatches>> kept_;
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
                      Scene scene,
                      const GpuCostMapBackendFactory& make_gpu_backend) {
  Backend backend(options, make_gpu_backend);
  for (size_t i = 0; i < scene.frames.size(); ++i) {
    FrameCostMaps frame_cost_maps(
        options, source, &backend, scene, &scene.frames[i]);
    callback(i, frame_cost_maps.Compute());
  }
  return scene;
}

}  // namespace mfir
