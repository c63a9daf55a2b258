#include "src/dense/dense_feature_options.h"

#include <cmath>
#include <sstream>

#include "src/util/errors.h"
#include "src/util/option_checks.h"
#include "src/util/parse_number.h"

namespace mfir {
namespace {

void CheckAtMost(const char* name, double value, double maximum) {
  if (value > maximum) {
    throw UsageError("--MultiFrame." + std::string(name) + " is " +
                     FormatNumber(value) + ", but must be at most " +
                     FormatNumber(maximum) + ".");
  }
}

void CheckSift(const SiftFeatureOptions& options) {
  CheckAtLeast("sift_bin_size", options.bin_size, 2);
  CheckAtMost("sift_bin_size", options.bin_size, 64);
  if (options.bin_size % 2 != 0) {
    throw UsageError("--MultiFrame.sift_bin_size is " +
                     std::to_string(options.bin_size) +
                     ", but must be even: the descriptors of odd bins are "
                     "centred between pixels.");
  }
  CheckAtLeast("sift_smoothing", options.smoothing, 0.0);
  CheckAtMost("sift_smoothing", options.smoothing, 100.0);
}

void CheckChannelValues(const char* name,
                        const std::vector<double>& values,
                        const std::string& color_order) {
  const size_t num_channels = color_order == "grey" ? 1 : 3;
  if (values.size() != 1 && values.size() != num_channels) {
    throw UsageError("--MultiFrame." + std::string(name) + " has " +
                     std::to_string(values.size()) + " numbers, but " +
                     color_order + " needs 1 or " +
                     std::to_string(num_channels) + ".");
  }
}

void CheckOnnx(const OnnxFeatureOptions& options) {
  CheckOneOf("onnx_color_order", options.color_order, {"rgb", "bgr", "grey"});
  CheckChannelValues("onnx_mean",
                     ParseNumberList("onnx_mean", options.mean),
                     options.color_order);
  const std::vector<double> std = ParseNumberList("onnx_std", options.std);
  CheckChannelValues("onnx_std", std, options.color_order);
  for (const double value : std) CheckAtLeast("onnx_std", value, 1e-6);
  CheckAtLeast("onnx_stride", options.stride, 0);
  CheckAtMost("onnx_stride", options.stride, 256);
  CheckAtLeast("onnx_tile_alignment", options.tile_alignment, 1);
  CheckAtMost("onnx_tile_alignment", options.tile_alignment, 1024);
  CheckAtLeast("onnx_tile_overlap", options.tile_overlap, 0);
  CheckAtMost("onnx_tile_overlap", options.tile_overlap, 4096);
  CheckAtLeast("onnx_tile_size", options.tile_size, 32);
  CheckAtMost("onnx_tile_size", options.tile_size, 1 << 15);
  if (options.tile_size % options.tile_alignment != 0) {
    throw UsageError("--MultiFrame.onnx_tile_size " +
                     std::to_string(options.tile_size) +
                     " must be a multiple of onnx_tile_alignment " +
                     std::to_string(options.tile_alignment) + ".");
  }
}

}  // namespace

void DenseFeatureOptions::Check(const std::string& source) const {
  CheckAtLeast("feature_patch_size", patch_size, 4);
  CheckAtMost("feature_patch_size", patch_size, 128);
  CheckSift(sift);
  CheckOnnx(onnx);
  if (source == "onnx" && onnx.path.empty()) {
    throw UsageError(
        "--MultiFrame.dense_features onnx needs the network: "
        "--MultiFrame.onnx_path FILE.onnx.");
  }
  if (source == "database" && database_path.empty()) {
    throw UsageError(
        "--MultiFrame.dense_features database needs the file: "
        "--MultiFrame.dense_feature_path FILE.");
  }
  if (source == "none" && !write_path.empty()) {
    throw UsageError(
        "--MultiFrame.write_dense_features has nothing to write with "
        "dense_features none.");
  }
}

std::vector<double> ParseNumberList(const std::string& option_name,
                                    const std::string& text) {
  std::vector<double> values;
  std::istringstream stream(text + ",");
  std::string item;
  while (std::getline(stream, item, ',')) {
    double value;
    if (!ParseNumber(item, &value) || !std::isfinite(value)) {
      throw UsageError("--MultiFrame." + option_name + " is '" + text +
                       "', but must be numbers separated by commas, like "
                       "0.485,0.456,0.406.");
    }
    values.push_back(value);
  }
  return values;
}

}  // namespace mfir
