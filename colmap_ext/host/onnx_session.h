// The ONNX Runtime that COLMAP 4 can be built with (ONNX_ENABLED).

#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace mfir::host {

// A network in a file. All functions throw std::exception.
class OnnxSession {
 public:
  struct Tensor {
    std::vector<int64_t> shape;
    // Row by row; null if they are no floats.
    std::shared_ptr<const float> values;
  };

  virtual ~OnnxSession() = default;

  // The first one.
  virtual std::string InputName() const = 0;
  virtual std::vector<std::string> OutputNames() const = 0;

  // `values`, row by row, are not changed.
  virtual Tensor Run(const std::string& input_name,
                     const std::vector<int64_t>& shape,
                     float* values,
                     const std::string& output_name) = 0;
};

// Whether this COLMAP has the runtime, and with CUDA.
bool HasOnnxRuntime();
bool HasOnnxRuntimeOnGpu();

// Null without the runtime. gpu_index: -1: on the CPU.
std::unique_ptr<OnnxSession> OpenOnnxSession(const std::string& path,
                                             int num_threads,
                                             int gpu_index);

}  // namespace mfir::host
