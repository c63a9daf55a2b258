#include "colmap_ext/io/input_file.h"
#include "colmap_ext/io/json_file.h"
#include "colmap_ext/rig_formats/camera_fields.h"
#include "colmap_ext/rig_formats/formats.h"

namespace mfir {
namespace {

// k1 k2 p1 p2 k3
constexpr size_t kNumPanopticDistortion = 5;

KnownCamera ReadCamera(const JsonValue& json, double pixel_offset) {
  KnownCamera camera;
  camera.image_name = json.At("name").Text();
  const std::string where = json.Where() + ": camera " + camera.image_name;
  Eigen::Matrix<double, 3, 4> pose;
  // Before, since they may throw.
  const Eigen::Matrix3d R = json.At("R").Matrix<3, 3>();
  const Eigen::Vector3d t = json.At("t").Matrix<3, 1>();
  pose << R, t;
  SetPose(pose, where, &camera);
  const auto distortion = json.Find("distCoef");
  SetIntrinsics(json.At("K").Matrix<3, 3>(),
                distortion ? distortion->Numbers() : std::vector<double>(),
                pixel_offset,
                where,
                &camera);
  if (const auto resolution = json.Find("resolution")) {
    const std::vector<JsonValue> sides = resolution->Elements();
    if (sides.size() != 2) resolution->Fail("is not [width, height]");
    camera.width = sides[0].ImageSize();
    camera.height = sides[1].ImageSize();
  }
  return camera;
}

}  // namespace

Cameras ReadPanopticRig(const std::string& path,
                        double pixel_offset,
                        RigRemarks* /*remarks*/) {
  const nlohmann::json json = ParseJson(path, ReadTextFile(path));
  Cameras cameras;
  for (const JsonValue& camera :
       JsonValue(&json, path, "").At("cameras").Elements()) {
    cameras.push_back(ReadCamera(camera, pixel_offset));
  }
  return cameras;
}

void WritePanopticRig(const std::string& path,
                      const Cameras& cameras,
                      double pixel_offset,
                      RigRemarks* remarks) {
  LensFitter fitter("panoptic", kNumPanopticDistortion, /*has_fisheye=*/false);
  nlohmann::ordered_json list = nlohmann::ordered_json::array();
  for (const KnownCamera& camera : cameras) {
    RequireIntrinsics("panoptic", camera);
    Lens lens = fitter.Fit(camera);
    lens.distortion.resize(kNumPanopticDistortion);
    const Eigen::Matrix3d K = lens.K(pixel_offset);
    const Eigen::Matrix<double, 3, 4> pose = PoseMatrix(camera);
    // The node is a number for the toolbox's own use.
    nlohmann::ordered_json entry = {{"name", WrittenName(camera)},
                                    {"type", "hd"},
                                    {"panel", 0},
                                    {"node", list.size()}};
    if (camera.width > 0) {
      entry["resolution"] = {camera.width, camera.height};
    }
    for (int row = 0; row < 3; ++row) {
      entry["K"].push_back({K(row, 0), K(row, 1), K(row, 2)});
    }
    entry["distCoef"] = lens.distortion;
    for (int row = 0; row < 3; ++row) {
      entry["R"].push_back({pose(row, 0), pose(row, 1), pose(row, 2)});
    }
    for (int row = 0; row < 3; ++row) {
      entry["t"].push_back(nlohmann::ordered_json::array({pose(row, 3)}));
    }
    list.push_back(std::move(entry));
  }
  fitter.AddRemarks(remarks);
  const nlohmann::ordered_json json = {{"cameras", list}};
  WriteRigFile(path, json.dump(1) + "\n");
}

}  // namespace mfir
