// The command multi_frame_evaluator.

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <limits>
#include <nlohmann/json.hpp>

#include "colmap_ext/exe/command.h"
#include "colmap_ext/frames/frames.h"
#include "colmap_ext/host/reconstruction.h"
#include "colmap_ext/io/work_folder.h"
#include "colmap_ext/models/camera_models.h"
#include "colmap_ext/models/model_io.h"
#include "colmap_ext/options/option_parser.h"
#include "colmap_ext/rigs/rig_io.h"
#include "src/evaluation/evaluation.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

struct EvaluatorOptions {
  std::string input_path;
  std::string ground_truth_path;
  std::string ground_truth_format = "auto";
  double ground_truth_pixel_offset = std::numeric_limits<double>::quiet_NaN();
  std::string camera_name_regex;
  std::string frame_list_path;
  std::string output_path;
};

EvaluatorOptions ParseEvaluatorOptions(int argc, char** argv) {
  EvaluatorOptions options;
  OptionParser parser;
  parser.SetHelp(
      "Compares intrinsics with known ones: mean errors of focal lengths and "
      "principal points, and the part\nthat all cameras share.",
      "colmap multi_frame_evaluator --input_path OUT --ground_truth_path RIG");
  parser.AddRequired("input_path",
                     &options.input_path,
                     "Result of the refiner, a model, or a folder of frames");
  parser.AddRequired("ground_truth_path",
                     &options.ground_truth_path,
                     "Cameras with the true intrinsics");
  parser.Add("ground_truth_format",
             &options.ground_truth_format,
             "auto, " + RigFormatNames());
  parser.Add("ground_truth_pixel_offset",
             &options.ground_truth_pixel_offset,
             "Added to true principal points; nan: that of the format");
  parser.Add("MultiFrame.camera_name_regex",
             &options.camera_name_regex,
             "One capture group: the camera name within an image name");
  parser.Add("frame_list_path",
             &options.frame_list_path,
             "File with the names of the frames to evaluate, one per line");
  parser.Add("output_path", &options.output_path, "JSON file to write");
  parser.AddSharedSection("MultiFrame");
  parser.Parse(argc, argv);

  CheckRigFormat("ground_truth_format", options.ground_truth_format);
  CheckPixelOffset("--ground_truth_pixel_offset",
                   options.ground_truth_pixel_offset);
  return options;
}

// Intrinsics of all images of a model. An image that the regular expression
// does not match goes by its own name: a rig model has camera names as image
// names where its source has no images.
std::vector<CameraIntrinsics> ReadEstimatedCameras(const std::string& path,
                                                   const CameraNaming& naming) {
  host::Reconstruction reconstruction;
  ReadModel(path, /*require_points=*/false, &reconstruction);
  std::vector<std::string> image_names;
  std::vector<const host::Image*> images;
  for (const auto& [image_id, image] : reconstruction.Images()) {
    images.push_back(&image);
    image_names.push_back(image.Name());
  }
  const std::vector<std::string> camera_names = naming.Names(image_names);

  std::vector<CameraIntrinsics> cameras(images.size());
  for (size_t i = 0; i < images.size(); ++i) {
    const host::Camera& camera = reconstruction.Camera(images[i]->CameraId());
    cameras[i].name = camera_names[i].empty()
                          ? CanonicalCameraName(image_names[i])
                          : camera_names[i];
    cameras[i].model = FindCameraModel(host::ModelId(camera));
    cameras[i].width = host::Width(camera);
    cameras[i].height = host::Height(camera);
    cameras[i].params = host::Params(camera);
  }
  return cameras;
}

std::vector<CameraIntrinsics> ReadTrueCameras(const EvaluatorOptions& options,
                                              const CameraNaming& naming) {
  const Rig rig = ReadRig(options.ground_truth_path,
                          options.ground_truth_format,
                          naming,
                          options.ground_truth_pixel_offset);
  for (const std::string& remark : rig.remarks) {
    std::cout << remark << std::endl;
  }
  std::vector<CameraIntrinsics> cameras;
  for (const KnownCamera& camera : rig.cameras) {
    cameras.push_back({camera.name,
                       camera.model,
                       camera.width,
                       camera.height,
                       camera.params});
  }
  return cameras;
}

// One estimate per frame of the folder. Sub-folders without a model are no
// frames; they are reported.
std::vector<FrameIntrinsics> ReadFrameEstimates(const EvaluatorOptions& options,
                                                const CameraNaming& naming) {
  const std::vector<std::string> names =
      ListFrames("input_path", options.input_path, options.frame_list_path);
  std::vector<FrameIntrinsics> estimates;
  for (const std::string& name : names) {
    const std::string model_path =
        FindSparseModel((fs::path(options.input_path) / name).string());
    if (model_path.empty()) {
      std::cerr << "WARNING: " << options.input_path << ": the folder '" << name
                << "' has no sparse model and is left out." << std::endl;
      continue;
    }
    estimates.push_back(
        {name, ReadEstimatedCameras(model_path, naming.OfFrame(name))});
  }
  if (estimates.empty()) {
    throw InputError(
        "--input_path " + options.input_path +
        ": neither a result (rig/ with summary.json or frames/), nor a model "
        "(cameras and images, .bin or .txt), nor a folder with one sub-folder "
        "per frame that has a sparse model.");
  }
  return estimates;
}

std::vector<FrameIntrinsics> ReadEstimates(const EvaluatorOptions& options,
                                           const CameraNaming& naming) {
  const fs::path path = options.input_path;
  if (!fs::is_directory(path)) {
    throw InputError("--input_path " + path.string() +
                     ": there is no such folder.");
  }
  const bool is_result =
      IsModelFolder((path / "rig").string()) &&
      (fs::exists(path / "summary.json") || fs::is_directory(path / "frames"));
  if (!is_result && !IsModelFolder(path.string())) {
    return ReadFrameEstimates(options, naming);
  }
  if (!options.frame_list_path.empty()) {
    throw UsageError("--frame_list_path selects from a folder of frames, but " +
                     path.string() + " is one " +
                     (is_result ? "multi-frame result." : "model."));
  }
  const fs::path model_path = is_result ? path / "rig" : path;
  return {{"",
           ReadEstimatedCameras(
               model_path.string(),
               naming.OfFrame(path.lexically_normal().filename().string()))}};
}

// A file that exists may be the ground truth, or the summary of the result.
void CheckEvaluatorOutput(const std::string& path) {
  std::error_code ignored;
  if (path.empty() || !fs::exists(path, ignored)) return;
  if (!fs::is_regular_file(path, ignored)) {
    throw OutputError("--output_path " + path + " is not a regular file.");
  }
  std::ifstream file(path);
  const nlohmann::json json =
      nlohmann::json::parse(file, nullptr, /*allow_exceptions=*/false);
  if (!json.is_object() || !json.contains("focal_abs")) {
    throw OutputError("--output_path " + path +
                      " exists, and is no evaluation: it is not replaced. "
                      "Remove it, or give another file.");
  }
}

// File names need not be UTF-8, JSON must be.
void WriteJson(const std::string& path, const nlohmann::ordered_json& json) {
  ReplaceFile(
      path,
      json.dump(
          2, ' ', false, nlohmann::ordered_json::error_handler_t::replace) +
          "\n");
}

Evaluation Evaluate(const EvaluatorOptions& options) {
  const CameraNaming naming(options.camera_name_regex);
  const std::vector<CameraIntrinsics> truth = ReadTrueCameras(options, naming);
  const std::vector<FrameIntrinsics> estimates = ReadEstimates(options, naming);
  try {
    return EvaluateIntrinsics(estimates, truth);
  } catch (const InputError& error) {
    throw InputError(options.input_path + " against " +
                     options.ground_truth_path + ": " + error.what());
  }
}

}  // namespace

int RunMultiFrameEvaluator(int argc, char** argv) {
  return RunCommand([argc, argv]() {
    const EvaluatorOptions options = ParseEvaluatorOptions(argc, argv);
    CheckEvaluatorOutput(options.output_path);
    const Evaluation evaluation = Evaluate(options);
    PrintEvaluation(evaluation, std::cout);
    if (!options.output_path.empty()) {
      WriteJson(options.output_path, EvaluationToJson(evaluation));
      std::cout << "\nWritten to " << options.output_path << std::endl;
    }
  });
}

}  // namespace mfir
