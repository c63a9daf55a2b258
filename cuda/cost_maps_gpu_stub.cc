// In place of cost_maps_gpu.cu where there is no CUDA compiler.

#include "cuda/cost_maps_gpu.h"

#include "src/util/gpu_choice.h"

namespace mfir {

std::unique_ptr<CostMapBackend> CreateGpuCostMapBackend(int, int) {
  throw GpuError("this build has no CUDA");
}

}  // namespace mfir
