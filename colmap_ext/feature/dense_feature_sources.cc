#include "colmap_ext/feature/dense_feature_sources.h"

#include <filesystem>

#include "colmap_ext/feature/feature_database.h"
#include "colmap_ext/feature/image_folder.h"
#include "colmap_ext/feature/onnx_feature_source.h"
#include "colmap_ext/feature/sift_feature_source.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

// `where` completes "is not in" or "are not in".
void ReportMissing(
    const std::vector<DenseFeatureRequest>& requests,
    const std::function<bool(const DenseFeatureRequest&)>& exists,
    const std::string& where,
    const std::function<void(const std::string&)>& log) {
  size_t num_missing = 0;
  std::string first;
  for (const DenseFeatureRequest& request : requests) {
    if (exists(request)) continue;
    if (num_missing++ == 0) {
      first = "image '" + request.image_name + "' of frame '" +
              request.frame_name + "'";
    }
  }
  if (num_missing == 0) return;
  if (num_missing == requests.size()) {
    throw InputError("None of the " + std::to_string(requests.size()) +
                     " images is in " + where + " (the first: " + first +
                     "). Correct the path, or set --MultiFrame.dense_features "
                     "none.");
  }
  log("WARNING: no dense features for " + std::to_string(num_missing) + " of " +
      std::to_string(requests.size()) + " images, which are not in " + where +
      " (the first: " + first + ")");
}

std::unique_ptr<DenseFeatureSource> OpenDatabase(
    const std::string& path,
    const std::vector<DenseFeatureRequest>& requests,
    const std::function<void(const std::string&)>& log) {
  auto database = std::make_unique<FeatureDatabase>(path);
  ReportMissing(
      requests,
      [&](const DenseFeatureRequest& request) {
        return database->HasImage(request.frame_name, request.camera_name);
      },
      "--MultiFrame.dense_feature_path " + path,
      log);
  return database;
}

std::unique_ptr<DenseFeatureSource> ComputeFromImages(
    const MultiFrameOptions& options,
    const std::string& image_path,
    const std::vector<DenseFeatureRequest>& requests,
    const std::function<void(const std::string&)>& log) {
  if (image_path.empty()) {
    throw UsageError("--MultiFrame.dense_features " + options.dense_features +
                     " needs the images: --image_path IMAGES.");
  }
  const ImageFolder images(image_path);
  ReportMissing(
      requests,
      [&](const DenseFeatureRequest& request) {
        return !images.Find(request).empty();
      },
      "--image_path " + image_path +
          ", as FRAME/IMAGE_NAME, IMAGE_NAME, CAMERA/FRAME.ext or "
          "CAMERA_FRAME.ext",
      log);
  const DenseFeatureOptions& features = options.features;
  if (options.dense_features == "sift") {
    return std::make_unique<SiftFeatureSource>(features.sift,
                                               features.patch_size,
                                               options.EffectiveNumThreads(),
                                               image_path);
  }
  return MakeOnnxFeatureSource(features.onnx,
                               features.patch_size,
                               options.EffectiveNumThreads(),
                               image_path,
                               options.use_gpu,
                               options.gpu_index);
}

bool SameFile(const std::string& a, const std::string& b) {
  std::error_code error;
  return a == b || std::filesystem::equivalent(a, b, error);
}

}  // namespace

void AddDenseFeatureOptions(MultiFrameOptions* multi_frame,
                            OptionParser* parser) {
  const auto add = [&](const char* name, auto* value, const char* help) {
    parser->Add(std::string("MultiFrame.") + name, value, help);
  };
  add("dense_features",
      &multi_frame->dense_features,
      "none, sift, onnx or database");
  DenseFeatureOptions* options = &multi_frame->features;
  add("feature_patch_size",
      &options->patch_size,
      "Side of the patches that are computed (feature pixels)");
  add("sift_bin_size",
      &options->sift.bin_size,
      "Width of the 4 x 4 bins of a descriptor (px, even)");
  add("sift_smoothing",
      &options->sift.smoothing,
      "Standard deviation of the Gaussian on the image (px)");
  OnnxFeatureOptions* onnx = &options->onnx;
  add("onnx_path", &onnx->path, "Fully convolutional network");
  add("onnx_input",
      &onnx->input_name,
      "Name of its input; empty: the only one");
  add("onnx_output",
      &onnx->output_name,
      "Name of the descriptor map; empty: the only output");
  add("onnx_color_order", &onnx->color_order, "rgb, bgr or grey");
  add("onnx_mean",
      &onnx->mean,
      "Subtracted from values 0 to 1, one number or one per channel");
  add("onnx_std", &onnx->std, "Divides the difference");
  add("onnx_l2_normalize",
      &onnx->l2_normalize,
      "Scale each descriptor to unit length");
  add("onnx_stride",
      &onnx->stride,
      "Image pixels per pixel of the map; 0: from its size");
  add("onnx_tile_size", &onnx->tile_size, "Side of the largest tile (px)");
  add("onnx_tile_overlap",
      &onnx->tile_overlap,
      "Radius of the receptive field (px)");
  add("onnx_tile_alignment",
      &onnx->tile_alignment,
      "Tile sides are multiples of this (px)");
  add("onnx_fixed_size",
      &onnx->fixed_size,
      "The network takes inputs of onnx_tile_size x onnx_tile_size only");
  add("dense_feature_path",
      &options->database_path,
      "SQLite file that 'database' reads");
  add("write_dense_features",
      &options->write_path,
      "SQLite file to write the features to");
}

std::unique_ptr<DenseFeatureSource> MakeDenseFeatureSource(
    const MultiFrameOptions& options,
    const std::string& image_path,
    const std::vector<DenseFeatureRequest>& requests,
    const std::function<void(const std::string&)>& log) {
  options.features.Check(options.dense_features);
  const DenseFeatureOptions& features = options.features;
  const bool from_database = options.dense_features == "database";
  if (from_database && !features.write_path.empty() &&
      SameFile(features.database_path, features.write_path)) {
    throw UsageError(
        "--MultiFrame.write_dense_features must not be the file that "
        "--MultiFrame.dense_feature_path reads.");
  }
  std::unique_ptr<DenseFeatureSource> source =
      from_database ? OpenDatabase(features.database_path, requests, log)
                    : ComputeFromImages(options, image_path, requests, log);
  if (!features.write_path.empty()) {
    source = MakeWritingFeatureSource(std::move(source), features.write_path);
  }
  return source;
}

}  // namespace mfir
