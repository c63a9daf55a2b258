#include "colmap_ext/feature/onnx_feature_source.h"

#include <algorithm>
#include <cmath>
#include <map>

#include "colmap_ext/feature/image_folder.h"
#include "colmap_ext/feature/network.h"
#include "colmap_ext/host/image_file.h"
#include "src/feature/image_tiles.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

class OnnxFeatureSource : public DenseFeatureSource {
 public:
  OnnxFeatureSource(const OnnxFeatureOptions& options,
                    int patch_size,
                    int num_threads,
                    int use_gpu,
                    int gpu_index,
                    const std::string& image_path)
      : options_(options),
        patch_size_(patch_size),
        images_(image_path),
        mean_(ParseNumberList("onnx_mean", options.mean)),
        std_(ParseNumberList("onnx_std", options.std)),
        num_input_channels_(options.color_order == "grey" ? 1 : 3),
        network_(options, num_threads, use_gpu, gpu_index) {
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
  const int margin =
      options_.tile_overlap + static_cast<int>(std::lround(radius));
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
    const std::string& image_path,
    int use_gpu,
    int gpu_index) {
  return std::make_unique<OnnxFeatureSource>(
      options, patch_size, num_threads, use_gpu, gpu_index, image_path);
}

}  // namespace mfir
