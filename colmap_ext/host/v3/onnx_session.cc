#include "colmap_ext/host/onnx_session.h"

namespace mfir::host {

bool HasOnnxRuntime() { return false; }

bool HasOnnxRuntimeOnGpu() { return false; }

std::unique_ptr<OnnxSession> OpenOnnxSession(const std::string&, int, int) {
  return nullptr;
}

}  // namespace mfir::host
