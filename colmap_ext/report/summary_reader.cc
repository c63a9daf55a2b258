#include "colmap_ext/report/summary_reader.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <map>
#include <stdexcept>

#include "colmap_ext/io/input_file.h"
#include "colmap_ext/models/camera_models.h"
#include "src/report/html.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

using Json = nlohmann::ordered_json;

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

[[noreturn]] void Fail(const std::string& path, const std::string& what) {
  throw InputError(
      (std::filesystem::path(path) / "summary.json").string() + ": " + what +
      ". Give the folder that multi_frame_intrinsics_refiner has written.");
}

// Numbers of an array, null is NaN.
std::vector<double> Numbers(const Json& array) {
  std::vector<double> numbers;
  for (const Json& value : array) {
    numbers.push_back(value.is_null() ? kNaN : value.get<double>());
  }
  return numbers;
}

// From standard deviations and correlations. The covariance of a parameter that
// is held (standard deviation 0) is 0.
Eigen::MatrixXd MakeCovariance(const std::vector<double>& stds,
                               const Json& correlations) {
  const auto size = static_cast<Eigen::Index>(stds.size());
  Eigen::MatrixXd covariance(size, size);
  for (Eigen::Index i = 0; i < size; ++i) {
    const std::vector<double> row = Numbers(correlations.at(i));
    for (Eigen::Index j = 0; j < size; ++j) {
      const double product = stds[i] * stds[j];
      covariance(i, j) = product == 0.0 ? 0.0
                         : i == j       ? product
                                        : product * row.at(j);
    }
  }
  return covariance;
}

ReportCamera ReadCamera(const Json& json) {
  ReportCamera camera;
  camera.name = json.at("name").get<std::string>();
  const std::string model_name = json.at("model").get<std::string>();
  camera.model = FindCameraModel(model_name);
  if (camera.model == nullptr) {
    throw std::invalid_argument("the camera model '" + model_name +
                                "' is unknown");
  }
  camera.param_names = CameraParamNames(*camera.model);
  camera.width = json.at("width").get<size_t>();
  camera.height = json.at("height").get<size_t>();
  camera.num_observations = json.at("num_observations").get<size_t>();
  camera.params = Numbers(json.at("params"));
  camera.params_std = Numbers(json.at("params_std"));
  for (const auto* values : {&camera.params, &camera.params_std}) {
    if (values->size() != camera.model->NumParams() ||
        values->size() != camera.param_names.size()) {
      throw std::invalid_argument("'params' must have " +
                                  std::to_string(camera.model->NumParams()) +
                                  " numbers");
    }
  }
  camera.covariance =
      MakeCovariance(camera.params_std, json.at("correlations"));
  camera.flags = json.at("flags").get<std::vector<std::string>>();
  return camera;
}

// Throws std::invalid_argument if these are not parameters of the model.
CameraValues MakeValues(const CameraModel* model, const Json& params) {
  CameraValues values = {model, Numbers(params), {}};
  if (model != nullptr && values.params.size() != model->NumParams()) {
    throw std::invalid_argument(
        "there must be " + std::to_string(model->NumParams()) + " parameters");
  }
  return values;
}

bool HasFlag(const ReportCamera& camera, const std::string& flag) {
  return std::find(camera.flags.begin(), camera.flags.end(), flag) !=
         camera.flags.end();
}

// As the refiner compares: cameras that could change, of the same model.
void MeasureDrifts(const Report& report, Comparison* comparison) {
  std::vector<RigCamera> cameras;
  std::vector<size_t> num_observations;
  DriftReference reference;
  for (size_t i = 0; i < report.cameras.size(); ++i) {
    const ReportCamera& camera = report.cameras[i];
    cameras.push_back({camera.name,
                       camera.cam_from_world,
                       camera.model,
                       camera.width,
                       camera.height,
                       camera.params});
    num_observations.push_back(camera.num_observations);
    const bool could_change =
        !HasFlag(camera, "constant") && !HasFlag(camera, "no_observations");
    const CameraValues& before = comparison->cameras[i];
    reference.push_back(could_change && before.model == camera.model
                            ? before.params
                            : std::vector<double>());
  }
  comparison->drifts = FindDrifts(cameras, num_observations, reference);
}

}  // namespace

Json ReadSummary(const std::string& path) {
  const std::string file =
      (std::filesystem::path(path) / "summary.json").string();
  if (!std::filesystem::is_directory(path)) {
    throw InputError(path + ": there is no such folder.");
  }
  if (!std::filesystem::exists(file)) Fail(path, "there is no such file");
  Json summary =
      Json::parse(ReadTextFile(file), nullptr, /*allow_exceptions=*/false);
  if (summary.is_discarded()) Fail(path, "not valid JSON");
  const Json version =
      summary.is_object() ? summary.value("schema_version", Json()) : Json();
  if (version != 1) Fail(path, "the field 'schema_version' is not 1");
  for (const char* field : {"frames", "cameras"}) {
    if (!summary.contains(field) || !summary[field].is_array()) {
      Fail(path, "the list '" + std::string(field) + "' is missing");
    }
  }
  for (const char* field : {"options", "inputs", "result"}) {
    if (!summary.contains(field) || !summary[field].is_object()) {
      Fail(path, "the object '" + std::string(field) + "' is missing");
    }
  }
  return summary;
}

std::vector<ReportCamera> ReadCameras(const std::string& path,
                                      const Json& summary) {
  std::vector<ReportCamera> cameras;
  for (const Json& json : summary["cameras"]) {
    try {
      cameras.push_back(ReadCamera(json));
    } catch (const std::exception& error) {
      Fail(path,
           "cameras[" + std::to_string(cameras.size()) + "]: " + error.what());
    }
  }
  if (cameras.empty()) Fail(path, "there are no cameras in it");
  return cameras;
}

Comparison CompareWithStart(const Report& report) {
  Comparison comparison;
  comparison.label = "the start";
  for (size_t i = 0; i < report.cameras.size(); ++i) {
    comparison.cameras.push_back(
        MakeValues(report.cameras[i].model,
                   report.summary["cameras"][i].at("params_initial")));
  }
  MeasureDrifts(report, &comparison);
  return comparison;
}

Comparison CompareWithRig(const Report& report) {
  Comparison comparison;
  comparison.label = "RIG";
  bool has_any = false;
  for (const Json& json : report.summary["cameras"]) {
    CameraValues values;
    const Json rig = json.value("rig", Json());
    if (rig.is_object()) {
      values = MakeValues(FindCameraModel(rig.at("model").get<std::string>()),
                          rig.at("params"));
      has_any = true;
    }
    comparison.cameras.push_back(values);
  }
  if (!has_any) return {};
  MeasureDrifts(report, &comparison);
  return comparison;
}

Comparison CompareWithResult(const Report& report, const std::string& path) {
  const Json summary = ReadSummary(path);
  std::map<std::string, CameraValues> earlier;
  for (const ReportCamera& camera : ReadCameras(path, summary)) {
    earlier[camera.name] = {camera.model, camera.params, camera.params_std};
  }
  Comparison comparison;
  comparison.label = path;
  while (comparison.label.size() > 1 && comparison.label.back() == '/') {
    comparison.label.pop_back();
  }
  comparison.created = TextAt(summary, "/created");
  comparison.is_result = true;
  for (const ReportCamera& camera : report.cameras) {
    const auto it = earlier.find(camera.name);
    comparison.cameras.push_back(it == earlier.end() ? CameraValues()
                                                     : it->second);
  }
  MeasureDrifts(report, &comparison);
  return comparison;
}

}  // namespace mfir
