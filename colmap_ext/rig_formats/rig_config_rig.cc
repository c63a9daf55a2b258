#include <cmath>

#include <Eigen/Geometry>

#include "colmap_ext/io/input_file.h"
#include "colmap_ext/io/json_file.h"
#include "colmap_ext/models/camera_models.h"
#include "colmap_ext/models/model_check.h"
#include "colmap_ext/rig_formats/camera_fields.h"
#include "colmap_ext/rig_formats/formats.h"
#include "src/sensor/camera_naming.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

// "rig1/camera1/" -> "camera1", "camera1_" -> "camera1".
std::string NameOfPrefix(const JsonValue& prefix) {
  std::string name = prefix.Text();
  name.erase(name.find_last_not_of("/\\_-.") + 1);
  const size_t separator = name.find_last_of("/\\");
  if (separator != std::string::npos) name.erase(0, separator + 1);
  if (name.empty()) prefix.Fail("names no camera");
  return name;
}

void ReadSensorPose(const JsonValue& sensor, KnownCamera* camera) {
  Eigen::Matrix<double, 3, 4> matrix = Eigen::Matrix<double, 3, 4>::Identity();
  const auto is_reference = sensor.Find("ref_sensor");
  if (!is_reference || !is_reference->Flag()) {
    const JsonValue rotation = sensor.At("cam_from_rig_rotation");
    const std::vector<double> q = rotation.Numbers(4);
    const Eigen::Quaterniond quaternion(q[0], q[1], q[2], q[3]);
    if (!(std::abs(quaternion.norm() - 1.0) < 1e-3)) {
      rotation.Fail("is not a unit quaternion (w, x, y, z)");
    }
    matrix.leftCols<3>() = quaternion.normalized().toRotationMatrix();
    matrix.col(3) = sensor.At("cam_from_rig_translation").Matrix<3, 1>();
  }
  SetPose(matrix, sensor.Where(), camera);
  camera->matrix.reset();
}

void ReadSensorIntrinsics(const JsonValue& sensor,
                          double pixel_offset,
                          KnownCamera* camera) {
  const auto model = sensor.Find("camera_model_name");
  const auto params = sensor.Find("camera_params");
  if (!model || !params) return;
  camera->model = FindCameraModel(model->Text());
  if (camera->model == nullptr) {
    model->Fail("'" + model->Text() + "' is not a camera model of COLMAP");
  }
  camera->params = params->Numbers(camera->model->NumParams());
  for (const size_t idx : camera->model->PrincipalPointIdxs()) {
    camera->params[idx] += pixel_offset;
  }
  const std::string problem = IntrinsicsProblem(*camera->model, camera->params);
  if (!problem.empty()) params->Fail("are wrong: " + problem);
}

}  // namespace

Cameras ReadRigConfig(const std::string& path,
                      double pixel_offset,
                      RigRemarks* /*remarks*/) {
  const nlohmann::json json = ParseJson(path, ReadTextFile(path));
  const JsonValue root(&json, path, "");
  const std::vector<JsonValue> rigs =
      root.IsArray() ? root.Elements() : std::vector<JsonValue>{root};
  if (rigs.size() != 1) {
    throw InputError(path + " has " + std::to_string(rigs.size()) +
                     " rigs, whose poses to each other are not known. Give one "
                     "rig.");
  }
  Cameras cameras;
  for (const JsonValue& sensor : rigs.front().At("cameras").Elements()) {
    KnownCamera camera;
    camera.image_name = NameOfPrefix(sensor.At("image_prefix"));
    ReadSensorPose(sensor, &camera);
    ReadSensorIntrinsics(sensor, pixel_offset, &camera);
    cameras.push_back(std::move(camera));
  }
  return cameras;
}

void WriteRigConfig(const std::string& path,
                    const Cameras& cameras,
                    double pixel_offset,
                    RigRemarks* remarks) {
  nlohmann::ordered_json sensors = nlohmann::ordered_json::array();
  bool has_size = false;
  for (const KnownCamera& camera : cameras) {
    nlohmann::ordered_json sensor = {
        {"image_prefix", WrittenName(camera) + "/"}};
    if (sensors.empty()) {
      sensor["ref_sensor"] = true;
    } else {
      const Rigid3& reference = cameras.front().cam_from_world;
      const Eigen::Quaterniond q =
          (camera.cam_from_world.rotation * reference.rotation.conjugate())
              .normalized();
      const Eigen::Vector3d t =
          camera.cam_from_world.translation - q * reference.translation;
      sensor["cam_from_rig_rotation"] = {q.w(), q.x(), q.y(), q.z()};
      sensor["cam_from_rig_translation"] = {t.x(), t.y(), t.z()};
    }
    if (camera.model != nullptr) {
      std::vector<double> params = camera.params;
      for (const size_t idx : camera.model->PrincipalPointIdxs()) {
        params[idx] -= pixel_offset;
      }
      sensor["camera_model_name"] = camera.model->Name();
      sensor["camera_params"] = params;
    }
    has_size = has_size || camera.width > 0;
    sensors.push_back(std::move(sensor));
  }
  remarks->push_back(
      "rig_config holds no world: poses are relative to camera "
      "'" +
      cameras.front().name + "'");
  if (has_size) remarks->push_back("rig_config holds no image sizes");
  nlohmann::ordered_json rigs = nlohmann::ordered_json::array();
  rigs.push_back({{"cameras", sensors}});
  WriteRigFile(path, rigs.dump(2) + "\n");
}

}  // namespace mfir
