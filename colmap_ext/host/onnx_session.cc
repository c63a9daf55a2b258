#include "colmap_ext/host/onnx_session.h"

#ifdef COLMAP_ONNX_ENABLED
#include <onnxruntime_cxx_api.h>
#endif

namespace mfir::host {

#ifdef COLMAP_ONNX_ENABLED

namespace {

// In the stead of colmap::ONNXModel, which computes all outputs and logs the
// failures that we report.
class Session final : public OnnxSession {
 public:
  Session(const std::string& path, int num_threads, int gpu_index) {
    Ort::SessionOptions options;
    options.SetInterOpNumThreads(1);
    options.SetIntraOpNumThreads(num_threads);
    options.SetLogSeverityLevel(ORT_LOGGING_LEVEL_FATAL);
    if (gpu_index >= 0) {
      OrtCUDAProviderOptions cuda;
      cuda.device_id = gpu_index;
      options.AppendExecutionProvider_CUDA(cuda);
    }
    session_ = Ort::Session(env_, path.c_str(), options);
  }

  std::string InputName() const override {
    Ort::AllocatorWithDefaultOptions allocator;
    return session_.GetInputNameAllocated(0, allocator).get();
  }

  std::vector<std::string> OutputNames() const override {
    std::vector<std::string> names;
    Ort::AllocatorWithDefaultOptions allocator;
    for (size_t i = 0; i < session_.GetOutputCount(); ++i) {
      names.emplace_back(session_.GetOutputNameAllocated(i, allocator).get());
    }
    return names;
  }

  Tensor Run(const std::string& input_name,
             const std::vector<int64_t>& shape,
             float* values,
             const std::string& output_name) override {
    size_t num_values = 1;
    for (const int64_t size : shape) num_values *= static_cast<size_t>(size);
    const Ort::Value input = Ort::Value::CreateTensor<float>(
        Ort::MemoryInfo::CreateCpu(OrtArenaAllocator, OrtMemTypeDefault),
        values,
        num_values,
        shape.data(),
        shape.size());
    const char* input_names[] = {input_name.c_str()};
    const char* output_names[] = {output_name.c_str()};
    const auto outputs = std::make_shared<std::vector<Ort::Value>>(session_.Run(
        Ort::RunOptions(), input_names, &input, 1, output_names, 1));
    const Ort::Value& value = outputs->front();
    Tensor output;
    if (!value.IsTensor()) return output;
    const Ort::TensorTypeAndShapeInfo info = value.GetTensorTypeAndShapeInfo();
    output.shape = info.GetShape();
    if (info.GetElementType() == ONNX_TENSOR_ELEMENT_DATA_TYPE_FLOAT) {
      output.values = {outputs, value.GetTensorData<float>()};
    }
    return output;
  }

 private:
  Ort::Env env_;
  Ort::Session session_{nullptr};
};

}  // namespace

bool HasOnnxRuntime() { return true; }

bool HasOnnxRuntimeOnGpu() {
#ifdef COLMAP_CUDA_ENABLED
  return true;
#else
  return false;
#endif
}

std::unique_ptr<OnnxSession> OpenOnnxSession(const std::string& path,
                                             int num_threads,
                                             int gpu_index) {
  return std::make_unique<Session>(path, num_threads, gpu_index);
}

#else

bool HasOnnxRuntime() { return false; }

bool HasOnnxRuntimeOnGpu() { return false; }

std::unique_ptr<OnnxSession> OpenOnnxSession(const std::string&, int, int) {
  return nullptr;
}

#endif

}  // namespace mfir::host
