// Where reference features and cost maps are computed: on the CPU or a GPU.

#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "src/dense/cost_map_kernels.h"
#include "src/dense/dense_sift.h"

namespace mfir {

// One cost map to compute, see ComputeCostMap.
struct CostMapJob {
  const uint16_t* patch;
  const uint16_t* reference;
  uint16_t* cost_map;
};

// Both functions write only their outputs, so that a call that failed can be
// repeated on another backend.
class CostMapBackend {
 public:
  virtual ~CostMapBackend() = default;

  // For the log, e.g. "CPU".
  virtual std::string Name() const = 0;

  // Reference feature of track i = rows track_begins[i] ... track_begins[i + 1]
  // - 1 of `features` (fp16, num_channels each): its row, -1 if none of the
  // track is finite. See FindReferenceFeature.
  virtual std::vector<int64_t> FindReferences(
      const std::vector<uint16_t>& features,
      const std::vector<int64_t>& track_begins,
      int num_channels,
      float loss_scale) = 0;

  virtual void ComputeMaps(const PatchShape& shape,
                           float inverse_pixel_size,
                           const std::vector<CostMapJob>& jobs) = 0;

  // Whether LoadSift may be called: dense SIFT is computed here as well, and
  // its patches need not be brought here.
  virtual bool ComputesSift() const { return false; }
  virtual std::unique_ptr<DeviceSift> LoadSift(const SiftImage&) {
    return nullptr;
  }
};

std::unique_ptr<CostMapBackend> CreateCpuCostMapBackend(int num_threads);

}  // namespace mfir
