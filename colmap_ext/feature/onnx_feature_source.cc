#include "colmap_ext/feature/onnx_feature_source.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>

#include <opencv2/dnn.hpp>

#include "colmap_ext/feature/image_folder.h"
#include "colmap_ext/host/image_file.h"
#include "colmap_ext/io/quiet_opencv.h"
#include "src/feature/image_tiles.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

std::string JoinNames(const std::vector<std::string>& names) {
  std::string list;
  for (const std::string& name : names) {
    list += (list.empty() ? "'" : ", '") + name + "'";
  }
  return list;
}

// The network in the file, with one input and one output.
class Network {
 public:
  explicit Network(const OnnxFeatureOptions& options) : options_(options) {
    std::error_code error;
    if (!std::filesystem::is_regular_file(options.path, error)) {
      throw InputError("--MultiFrame.onnx_path " + options.path +
                       ": there is no such file.");
    }
    const QuietOpenCV quiet;
    try {
      net_ = cv::dnn::readNetFromONNX(options.path);
      net_.setPreferableBackend(cv::dnn::DNN_BACKEND_OPENCV);
      net_.setPreferableTarget(cv::dnn::DNN_TARGET_CPU);
    } catch (const cv::Exception& exception) {
      throw InputError(options.path +
                       ": OpenCV cannot read the network: " + exception.err);
    }
    output_name_ = options.output_name;
    const std::vector<std::string> names = net_.getUnconnectedOutLayersNames();
    if (output_name_.empty() && names.size() == 1) {
      output_name_ = names[0];
    } else if (output_name_.empty()) {
      throw UsageError(options.path +
                       " has several outputs: " + JoinNames(names) +
                       ". Name one with --MultiFrame.onnx_output.");
    }
  }

  // 1 x channels x height x width, of an input of the same kind.
  cv::Mat Run(const cv::Mat& input) {
    const QuietOpenCV quiet;
    cv::Mat output;
    try {
      net_.setInput(input, options_.input_name);
      output = net_.forward(output_name_);
    } catch (const cv::Exception& exception) {
      throw InputError(
          options_.path + ": the network does not run on an input of 1 x " +
          std::to_string(input.size[1]) + " x " +
          std::to_string(input.size[2]) + " x " +
          std::to_string(input.size[3]) + " (" + exception.err +
          "). Export it with variable height and width, or set "
          "--MultiFrame.onnx_fixed_size 1 and onnx_tile_size; check "
          "--MultiFrame.onnx_input, onnx_output, onnx_color_order and "
          "onnx_tile_alignment.");
    }
    if (output.dims != 4 || output.size[0] != 1 || output.type() != CV_32F) {
      throw InputError(options_.path + ": the output '" + output_name_ +
                       "' is not a map of 1 x channels x height x width of "
                       "32-bit floats. Name another with "
                       "--MultiFrame.onnx_output.");
    }
    return output;
  }

 private:
  const OnnxFeatureOptions& options_;
  cv::dnn::Net net_;
  std::string output_name_;
};

class OnnxFeatureSource : public DenseFeatureSource {
 public:
  OnnxFeatureSource(const OnnxFeatureOptions& options,
                    int patch_size,
                    int num_threads,
                    const std::string& image_path)
      : options_(options),
        patch_size_(patch_size),
        images_(image_path),
        mean_(ParseNumberList("onnx_mean", options.mean)),
        std_(ParseNumberList("onnx_std", options.std)),
        num_input_channels_(options.color_order == "grey" ? 1 : 3),
        network_(options_) {
    cv::setNumThreads(num_threads);
    mean_.resize(num_input_channels_, mean_[0]);
    std_.resize(num_input_channels_, std_[0]);
    Probe();
  }

  DenseFeaturePatches Extract(const DenseFeatureRequest& request) override;

 private:
  void Probe();
  cv::Mat Input(const host::Bitmap& bitmap,
                const std::vector<uint8_t>& pixels,
                const cv::Rect& tile) const;
  void CopyPatch(const cv::Mat& map,
                 const Eigen::Vector2i& corner_in_map,
                 size_t i,
                 DenseFeaturePatches* patches) const;

  const OnnxFeatureOptions options_;
  const int patch_size_;
  const ImageFolder images_;
  std::vector<double> mean_;
  std::vector<double> std_;
  const int num_input_channels_;
  Network network_;
  int num_channels_ = 0;
  int stride_ = 0;
};

// Finds stride and number of channels.
void OnnxFeatureSource::Probe() {
  const int alignment = options_.tile_alignment;
  const int size = options_.fixed_size
                       ? options_.tile_size
                       : (128 + alignment - 1) / alignment * alignment;
  const std::vector<int> shape = {1, num_input_channels_, size, size};
  const cv::Mat output = network_.Run(cv::Mat(shape, CV_32F, cv::Scalar(0.5)));
  num_channels_ = output.size[1];
  stride_ = options_.stride > 0 ? options_.stride
                                : size / std::max(1, output.size[3]);
  if (output.size[2] * stride_ != size || output.size[3] * stride_ != size) {
    throw InputError(
        options_.path + ": for an input of " + std::to_string(size) + " x " +
        std::to_string(size) + " the output has " +
        std::to_string(output.size[2]) + " x " +
        std::to_string(output.size[3]) + " pixels, which is no stride" +
        (options_.stride > 0 ? " of " + std::to_string(stride_) : "") +
        ". The network must pad its convolutions; check "
        "--MultiFrame.onnx_output and onnx_stride.");
  }
  if (alignment % stride_ != 0) {
    throw UsageError("--MultiFrame.onnx_tile_alignment " +
                     std::to_string(alignment) +
                     " must be a multiple of the stride of the network, " +
                     std::to_string(stride_) + ".");
  }
}

// `pixels` as RowMajorData gives them.
cv::Mat OnnxFeatureSource::Input(const host::Bitmap& bitmap,
                                 const std::vector<uint8_t>& pixels,
                                 const cv::Rect& tile) const {
  const std::vector<int> shape = {
      1, num_input_channels_, tile.height, tile.width};
  cv::Mat input(shape, CV_32F);
  for (int c = 0; c < num_input_channels_; ++c) {
    const int bitmap_channel =
        options_.color_order == "bgr" ? num_input_channels_ - 1 - c : c;
    const float scale = static_cast<float>(1.0 / (255.0 * std_[c]));
    const float offset = static_cast<float>(-mean_[c] / std_[c]);
    for (int y = 0; y < tile.height; ++y) {
      const size_t row = std::min(tile.y + y, bitmap.Height() - 1);
      float* out = input.ptr<float>(0, c) + static_cast<size_t>(y) * tile.width;
      for (int x = 0; x < tile.width; ++x) {
        const size_t column = std::min(tile.x + x, bitmap.Width() - 1);
        out[x] =
            offset +
            scale *
                pixels[(row * bitmap.Width() + column) * num_input_channels_ +
                       bitmap_channel];
      }
    }
  }
  return input;
}

void OnnxFeatureSource::CopyPatch(const cv::Mat& map,
                                  const Eigen::Vector2i& corner_in_map,
                                  size_t i,
                                  DenseFeaturePatches* patches) const {
  const int num_pixels = patch_size_ * patch_size_;
  Eigen::MatrixXf descriptors(num_channels_, num_pixels);
  for (int c = 0; c < num_channels_; ++c) {
    for (int row = 0; row < patch_size_; ++row) {
      const float* in =
          map.ptr<float>(0, c) +
          static_cast<size_t>(corner_in_map.y() + row) * map.size[3] +
          corner_in_map.x();
      for (int column = 0; column < patch_size_; ++column) {
        descriptors(c, row * patch_size_ + column) = in[column];
      }
    }
  }
  for (int pixel = 0; pixel < num_pixels; ++pixel) {
    if (options_.l2_normalize) descriptors.col(pixel).normalize();
    SetDescriptor(descriptors.col(pixel).data(),
                  i,
                  pixel % patch_size_,
                  pixel / patch_size_,
                  patches);
  }
}

DenseFeaturePatches OnnxFeatureSource::Extract(
    const DenseFeatureRequest& request) {
  host::Bitmap bitmap;
  if (!images_.Read(request, num_input_channels_ == 3, &bitmap)) {
    return NoPatches(request);
  }
  const std::vector<uint8_t> pixels = host::RowMajorData(bitmap);
  DenseFeaturePatches patches =
      PlacePatches(request, patch_size_, num_channels_, stride_);
  const double radius = 0.5 * patch_size_ * stride_;
  const int margin = options_.tile_overlap + static_cast<int>(radius + 0.5);
  const auto plan = [&](int image_size) {
    return PlanTiles(image_size,
                     options_.tile_size,
                     margin,
                     options_.tile_alignment,
                     options_.fixed_size);
  };
  const TilesAlongAxis columns = plan(request.width);
  const TilesAlongAxis rows = plan(request.height);
  std::map<std::pair<size_t, size_t>, std::vector<size_t>> patches_of_tiles;
  for (size_t i = 0; i < patches.valid.size(); ++i) {
    if (!patches.valid[i]) continue;
    const Eigen::Vector2d center = patches.corners[i].cast<double>() * stride_ +
                                   Eigen::Vector2d::Constant(radius);
    patches_of_tiles[{rows.TileOf(center.y()), columns.TileOf(center.x())}]
        .push_back(i);
  }
  for (const auto& [tile, indices] : patches_of_tiles) {
    const Eigen::Vector2i begin(columns.begins[tile.second],
                                rows.begins[tile.first]);
    const cv::Mat map = network_.Run(
        Input(bitmap,
              pixels,
              cv::Rect(begin.x(), begin.y(), columns.size, rows.size)));
    for (const size_t i : indices) {
      CopyPatch(map, patches.corners[i] - begin / stride_, i, &patches);
    }
  }
  InvalidateNonFinite(&patches);
  return patches;
}

}  // namespace

std::unique_ptr<DenseFeatureSource> MakeOnnxFeatureSource(
    const OnnxFeatureOptions& options,
    int patch_size,
    int num_threads,
    const std::string& image_path) {
  return std::make_unique<OnnxFeatureSource>(
      options, patch_size, num_threads, image_path);
}

}  // namespace mfir
