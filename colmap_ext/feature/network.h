// A fully convolutional network in an ONNX file.

#pragma once

#include <memory>
#include <string>

#include <opencv2/core.hpp>

#include "colmap_ext/host/onnx_session.h"
#include "src/dense/dense_feature_options.h"

namespace mfir {

// Runs on COLMAP's ONNX Runtime if it has one (with CUDA on a GPU, as use_gpu
// and gpu_index say), else on OpenCV's dnn module.
class Network {
 public:
  // Throws InputError for a file that is no network, UsageError for an output
  // that options.output_name has to choose, and for use_gpu = 1 where COLMAP's
  // runtime has CUDA and finds no GPU.
  Network(const OnnxFeatureOptions& options,
          int num_threads,
          int use_gpu,
          int gpu_index);

  // 1 x channels x height x width, of an input of the same kind. Throws
  // InputError.
  cv::Mat Run(cv::Mat input);

 private:
  const OnnxFeatureOptions options_;
  std::unique_ptr<host::OnnxSession> session_;
  std::string input_name_;
  std::string output_name_;
  // What the last Run() returned.
  host::OnnxSession::Tensor output_;
};

}  // namespace mfir
