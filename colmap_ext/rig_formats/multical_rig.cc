#include <map>

#include "colmap_ext/io/input_file.h"
#include "colmap_ext/io/json_file.h"
#include "colmap_ext/rig_formats/camera_fields.h"
#include "colmap_ext/rig_formats/formats.h"

namespace mfir {
namespace {

// Of the models "standard" (k1 k2 p1 p2 k3) and "rational" (and k4 k5 k6).
constexpr size_t kNumStandard = 5;
constexpr size_t kNumRational = 8;

// x_to = transform x_from.
struct RelativePose {
  std::string to;
  std::string from;
  Rigid3 to_from_from;
};

Rigid3 ReadTransform(const JsonValue& json) {
  Eigen::Matrix<double, 3, 4> matrix;
  // Before, since they may throw.
  const Eigen::Matrix3d R = json.At("R").Matrix<3, 3>();
  const Eigen::Vector3d T = json.At("T").Matrix<3, 1>();
  matrix << R, T;
  KnownCamera camera;
  SetPose(matrix, json.Where(), &camera);
  return camera.cam_from_world;
}

Rigid3 Product(const Rigid3& a, const Rigid3& b) {
  return {(a.rotation * b.rotation).normalized(), a * b.translation};
}

Rigid3 Inverse(const Rigid3& pose) {
  return {pose.rotation.conjugate(), pose.Center()};
}

// cam_from_world by camera. An entry "b" is the pose of b, "b_to_a" what maps
// coordinates of a to those of b.
std::map<std::string, Rigid3> ReadPoses(const JsonValue& json) {
  const std::string separator = "_to_";
  std::map<std::string, Rigid3> poses;
  std::vector<RelativePose> relative;
  for (const auto& [key, value] : json.Members()) {
    const size_t position = key.find(separator);
    if (position == std::string::npos) {
      poses[key] = ReadTransform(value);
    } else {
      relative.push_back({key.substr(0, position),
                          key.substr(position + separator.size()),
                          ReadTransform(value)});
    }
  }
  for (bool changed = true; changed;) {
    changed = false;
    for (const RelativePose& pose : relative) {
      const bool has_to = poses.count(pose.to) > 0;
      const bool has_from = poses.count(pose.from) > 0;
      if (has_to == has_from) continue;
      if (has_from) {
        poses[pose.to] = Product(pose.to_from_from, poses[pose.from]);
      } else {
        poses[pose.from] = Product(Inverse(pose.to_from_from), poses[pose.to]);
      }
      changed = true;
    }
  }
  return poses;
}

KnownCamera ReadCamera(const std::string& name,
                       const JsonValue& json,
                       double pixel_offset) {
  KnownCamera camera;
  camera.image_name = name;
  const auto distortion = json.Find("dist");
  SetIntrinsics(json.At("K").Matrix<3, 3>(),
                distortion ? distortion->Numbers() : std::vector<double>(),
                pixel_offset,
                json.Where(),
                &camera);
  const JsonValue size = json.At("image_size");
  const std::vector<JsonValue> sides = size.Elements();
  if (sides.size() != 2) size.Fail("is not [width, height]");
  camera.width = sides[0].ImageSize();
  camera.height = sides[1].ImageSize();
  return camera;
}

template <typename Matrix>
nlohmann::ordered_json Rows(const Matrix& matrix) {
  nlohmann::ordered_json rows = nlohmann::ordered_json::array();
  for (int row = 0; row < 3; ++row) {
    rows.push_back({matrix(row, 0), matrix(row, 1), matrix(row, 2)});
  }
  return rows;
}

}  // namespace

Cameras ReadMulticalRig(const std::string& path,
                        double pixel_offset,
                        RigRemarks* remarks) {
  const nlohmann::json json = ParseJson(path, ReadTextFile(path));
  const JsonValue root(&json, path, "");
  const std::map<std::string, Rigid3> poses =
      ReadPoses(root.At("camera_poses"));
  Cameras cameras;
  for (const auto& [name, value] : root.At("cameras").Members()) {
    const auto pose = poses.find(name);
    if (pose == poses.end()) {
      remarks->push_back(path + ": camera '" + name +
                         "' has no pose and is left out");
      continue;
    }
    cameras.push_back(ReadCamera(name, value, pixel_offset));
    cameras.back().cam_from_world = pose->second;
  }
  return cameras;
}

void WriteMulticalRig(const std::string& path,
                      const Cameras& cameras,
                      double pixel_offset,
                      RigRemarks* remarks) {
  LensFitter fitter("multical", kNumRational, /*has_fisheye=*/false);
  nlohmann::ordered_json intrinsics;
  nlohmann::ordered_json poses;
  for (const KnownCamera& camera : cameras) {
    RequireIntrinsics("multical", camera);
    RequireImageSize("multical", camera);
    std::vector<double> distortion;
    const Lens lens = fitter.Fit(camera);
    distortion = lens.distortion;
    const bool is_standard =
        distortion[5] == 0.0 && distortion[6] == 0.0 && distortion[7] == 0.0;
    distortion.resize(is_standard ? kNumStandard : kNumRational);
    const std::string name = WrittenName(camera);
    intrinsics[name] = {{"model", is_standard ? "standard" : "rational"},
                        {"image_size", {camera.width, camera.height}},
                        {"K", Rows(lens.K(pixel_offset))},
                        {"dist", nlohmann::ordered_json::array({distortion})}};
    const Eigen::Matrix<double, 3, 4> pose = PoseMatrix(camera);
    poses[name] = {{"R", Rows(pose)},
                   {"T", {pose(0, 3), pose(1, 3), pose(2, 3)}}};
  }
  fitter.AddRemarks(remarks);
  const nlohmann::ordered_json json = {{"cameras", intrinsics},
                                       {"camera_poses", poses}};
  WriteRigFile(path, json.dump(2) + "\n");
}

}  // namespace mfir
