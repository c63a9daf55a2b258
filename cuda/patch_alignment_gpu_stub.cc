// In place of patch_alignment_gpu.cu where there is no CUDA compiler.

#include "cuda/patch_alignment_gpu.h"

#include "src/util/gpu_choice.h"

namespace mfir {

std::unique_ptr<PatchBackend> CreateGpuPatchBackend(int) {
  throw GpuError("this build has no CUDA");
}

}  // namespace mfir
