#include "colmap_ext/feature/network.h"

#include <algorithm>
#include <filesystem>
#include <stdexcept>
#include <vector>

#include <opencv2/dnn.hpp>

#include "colmap_ext/io/quiet_opencv.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

class OpenCvSession final : public host::OnnxSession {
 public:
  OpenCvSession(const std::string& path, int num_threads) {
    cv::setNumThreads(num_threads);
    Try([&]() {
      net_ = cv::dnn::readNetFromONNX(path);
      net_.setPreferableBackend(cv::dnn::DNN_BACKEND_OPENCV);
      net_.setPreferableTarget(cv::dnn::DNN_TARGET_CPU);
    });
  }

  // OpenCV's name for the only input.
  std::string InputName() const override { return ""; }

  std::vector<std::string> OutputNames() const override {
    return net_.getUnconnectedOutLayersNames();
  }

  Tensor Run(const std::string& input_name,
             const std::vector<int64_t>& shape,
             float* values,
             const std::string& output_name) override {
    const auto output = std::make_shared<cv::Mat>();
    Try([&]() {
      net_.setInput(
          cv::Mat(std::vector<int>(shape.begin(), shape.end()), CV_32F, values),
          input_name);
      *output = net_.forward(output_name);
    });
    Tensor tensor;
    tensor.shape = {output->size.p, output->size.p + output->dims};
    if (output->type() == CV_32F && output->isContinuous()) {
      tensor.values = {output, output->ptr<float>()};
    }
    return tensor;
  }

 private:
  template <typename Function>
  static void Try(const Function& function) {
    const QuietOpenCV quiet;
    try {
      function();
    } catch (const cv::Exception& exception) {
      throw std::runtime_error(exception.err);
    }
  }

  cv::dnn::Net net_;
};

std::unique_ptr<host::OnnxSession> OpenSession(const std::string& path,
                                               int num_threads,
                                               int use_gpu,
                                               int gpu_index) {
  if (!host::HasOnnxRuntime()) {
    return std::make_unique<OpenCvSession>(path, num_threads);
  }
  if (use_gpu != 0 && host::HasOnnxRuntimeOnGpu()) {
    try {
      return host::OpenOnnxSession(path, num_threads, std::max(0, gpu_index));
    } catch (const std::exception& error) {
      if (use_gpu == 1) {
        throw UsageError("--MultiFrame.use_gpu 1: " + path +
                         " does not run on the GPU: " + error.what() +
                         "; use_gpu -1 takes the CPU then.");
      }
    }
  }
  return host::OpenOnnxSession(path, num_threads, /*gpu_index=*/-1);
}

std::string JoinNames(const std::vector<std::string>& names) {
  std::string list;
  for (const std::string& name : names) {
    list += (list.empty() ? "'" : ", '") + name + "'";
  }
  return list;
}

}  // namespace

Network::Network(const OnnxFeatureOptions& options,
                 int num_threads,
                 int use_gpu,
                 int gpu_index)
    : options_(options),
      input_name_(options.input_name),
      output_name_(options.output_name) {
  std::error_code error;
  if (!std::filesystem::is_regular_file(options.path, error)) {
    throw InputError("--MultiFrame.onnx_path " + options.path +
                     ": there is no such file.");
  }
  try {
    session_ = OpenSession(options.path, num_threads, use_gpu, gpu_index);
  } catch (const UsageError&) {
    throw;
  } catch (const std::exception& exception) {
    throw InputError(options.path + ": " +
                     (host::HasOnnxRuntime() ? "ONNX Runtime" : "OpenCV") +
                     " cannot read the network: " + exception.what());
  }
  if (input_name_.empty()) input_name_ = session_->InputName();
  if (!output_name_.empty()) return;
  const std::vector<std::string> names = session_->OutputNames();
  if (names.size() != 1) {
    throw UsageError(options.path +
                     " has several outputs: " + JoinNames(names) +
                     ". Name one with --MultiFrame.onnx_output.");
  }
  output_name_ = names[0];
}

cv::Mat Network::Run(cv::Mat input) {
  const std::vector<int64_t> shape(input.size.p, input.size.p + input.dims);
  try {
    output_ =
        session_->Run(input_name_, shape, input.ptr<float>(), output_name_);
  } catch (const std::exception& exception) {
    throw InputError(
        options_.path + ": the network does not run on an input of 1 x " +
        std::to_string(shape[1]) + " x " + std::to_string(shape[2]) + " x " +
        std::to_string(shape[3]) + " (" + exception.what() +
        "). Export it with variable height and width, or set "
        "--MultiFrame.onnx_fixed_size 1 and onnx_tile_size; check "
        "--MultiFrame.onnx_input, onnx_output, onnx_color_order and "
        "onnx_tile_alignment.");
  }
  if (output_.shape.size() != 4 || output_.shape[0] != 1 ||
      output_.values == nullptr) {
    throw InputError(options_.path + ": the output '" + output_name_ +
                     "' is not a map of 1 x channels x height x width of "
                     "32-bit floats. Name another with "
                     "--MultiFrame.onnx_output.");
  }
  // OpenCV has no matrices of constants; nobody writes to this one.
  return cv::Mat(std::vector<int>(output_.shape.begin(), output_.shape.end()),
                 CV_32F,
                 const_cast<float*>(output_.values.get()));
}

}  // namespace mfir
