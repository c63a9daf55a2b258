#include <cmath>
#include <set>

#include "colmap_ext/rig_formats/camera_fields.h"
#include "colmap_ext/rig_formats/formats.h"
#include "colmap_ext/rig_formats/yaml_file.h"
#include "src/util/errors.h"
#include "src/util/parse_number.h"

namespace mfir {
namespace {

std::string Key(size_t idx) { return "cam" + std::to_string(idx); }

class KalibrFile {
 public:
  explicit KalibrFile(const std::string& path)
      : path_(path), root_(ReadYamlFile(path)) {
    if (!root_.IsMap()) {
      throw InputError(path +
                       ": not a camchain of Kalibr, which has cam0, cam1, ... "
                       "at its top level. Give the camchain-*.yaml.");
    }
  }

  // Of cam0, cam1, ... Throws where one stands twice or is missing: the others
  // would be lost in silence.
  size_t NumCameras() const {
    std::set<std::string> keys;
    for (const auto& entry : root_) {
      const std::string key = entry.first.as<std::string>("");
      if (key.rfind("cam", 0) != 0 || key.size() == 3 ||
          key.find_first_not_of("0123456789", 3) != std::string::npos) {
        continue;
      }
      if (!keys.insert(key).second) {
        throw InputError(Where(key) +
                         " stands twice. Number the cameras, from cam0 on.");
      }
    }
    for (size_t i = 0; i < keys.size(); ++i) {
      if (keys.count(Key(i)) == 0) {
        throw InputError(Where(Key(i)) +
                         " is missing, but others are there. Number the "
                         "cameras, from cam0 on.");
      }
    }
    return keys.size();
  }

  bool Has(const std::string& camera, const std::string& key) const {
    return root_[camera].IsMap() && root_[camera][key].IsDefined();
  }

  std::string Text(const std::string& camera, const std::string& key) const {
    const YAML::Node node = Find(camera, key);
    if (!node.IsScalar()) Fail(camera, key, "is not a text");
    return node.Scalar();
  }

  // Numbers of a list of any depth.
  std::vector<double> Numbers(const std::string& camera,
                              const std::string& key) const {
    std::vector<double> numbers;
    Append(Find(camera, key), camera, key, &numbers);
    return numbers;
  }

  std::vector<double> Numbers(const std::string& camera,
                              const std::string& key,
                              size_t size) const {
    std::vector<double> numbers = Numbers(camera, key);
    if (numbers.size() != size) {
      Fail(camera,
           key,
           "has " + std::to_string(numbers.size()) + " numbers, not " +
               std::to_string(size));
    }
    return numbers;
  }

  std::string Where(const std::string& camera) const {
    return path_ + ": " + camera;
  }

  [[noreturn]] void Fail(const std::string& camera,
                         const std::string& key,
                         const std::string& what) const {
    throw InputError(Where(camera) + "." + key + " " + what +
                     ". Correct the field, or export the calibration again.");
  }

 private:
  YAML::Node Find(const std::string& camera, const std::string& key) const {
    if (!Has(camera, key)) Fail(camera, key, "is missing");
    return root_[camera][key];
  }

  void Append(const YAML::Node& node,
              const std::string& camera,
              const std::string& key,
              std::vector<double>* numbers) const {
    if (node.IsSequence()) {
      for (const YAML::Node& element : node) {
        Append(element, camera, key, numbers);
      }
      return;
    }
    double value;
    if (!node.IsScalar() || !ParseNumber(node.Scalar(), &value) ||
        !std::isfinite(value)) {
      Fail(camera,
           key,
           "has an element " + std::to_string(numbers->size() + 1) +
               " that is not a finite number");
    }
    numbers->push_back(value);
  }

  const std::string path_;
  const YAML::Node root_;
};

// x_cn = T_cn_cnm1 x_cn-1. The first camera is the world.
void ReadPose(const KalibrFile& file,
              const std::string& key,
              const KnownCamera* previous,
              KnownCamera* camera) {
  if (previous == nullptr) return;
  const std::vector<double> values = file.Numbers(key, "T_cn_cnm1", 16);
  if (values[12] != 0.0 || values[13] != 0.0 || values[14] != 0.0 ||
      values[15] != 1.0) {
    file.Fail(key, "T_cn_cnm1", "has another last row than 0 0 0 1");
  }
  SetPose(Eigen::Map<const Eigen::Matrix<double, 3, 4, Eigen::RowMajor>>(
              values.data()),
          file.Where(key),
          camera);
  const Rigid3 relative = camera->cam_from_world;
  camera->cam_from_world.rotation =
      (relative.rotation * previous->cam_from_world.rotation).normalized();
  camera->cam_from_world.translation =
      relative * previous->cam_from_world.translation;
  camera->matrix.reset();
}

void ReadIntrinsics(const KalibrFile& file,
                    const std::string& key,
                    double pixel_offset,
                    KnownCamera* camera) {
  const std::string model = file.Text(key, "camera_model");
  if (model != "pinhole") {
    file.Fail(key,
              "camera_model",
              "'" + model +
                  "' is no model of COLMAP: calibrate with pinhole-radtan or "
                  "pinhole-equi");
  }
  const std::vector<double> K = file.Numbers(key, "intrinsics", 4);
  Lens lens{Lens::Kind::kBrown,
            K[0],
            K[1],
            K[2] + pixel_offset,
            K[3] + pixel_offset,
            {}};
  const std::string distortion = file.Text(key, "distortion_model");
  size_t num_coefficients = 4;
  if (distortion == "equidistant") {
    lens.kind = Lens::Kind::kFisheye;
  } else if (distortion == "fov") {
    lens.kind = Lens::Kind::kFov;
    num_coefficients = 1;
  } else if (distortion == "none") {
    num_coefficients = 0;
  } else if (distortion != "radtan") {
    file.Fail(key,
              "distortion_model",
              "'" + distortion +
                  "' is unknown: radtan, equidistant, fov and none are known");
  }
  if (num_coefficients > 0) {
    lens.distortion = file.Numbers(key, "distortion_coeffs", num_coefficients);
  }
  SetLens(lens, file.Where(key), camera);
  for (const double side : file.Numbers(key, "resolution", 2)) {
    if (!(side >= 1.0 && side <= 1e6) || side != std::floor(side)) {
      file.Fail(key, "resolution", "is not an image size in pixels");
    }
  }
  camera->width = static_cast<size_t>(file.Numbers(key, "resolution")[0]);
  camera->height = static_cast<size_t>(file.Numbers(key, "resolution")[1]);
}

// "/left" and "/left/image_raw" -> "left"; "" for other topics.
std::string NameOfTopic(const KalibrFile& file, const std::string& key) {
  if (!file.Has(key, "rostopic")) return "";
  std::string topic = file.Text(key, "rostopic");
  const std::string end = "/image_raw";
  if (topic.size() > end.size() &&
      topic.compare(topic.size() - end.size(), end.size(), end) == 0) {
    topic.resize(topic.size() - end.size());
  }
  topic.erase(0, topic.find_first_not_of('/'));
  return topic.find('/') == std::string::npos ? topic : "";
}

// Cameras go by their topics if all have one that is a name, else by their
// keys.
void NameCameras(const KalibrFile& file, Cameras* cameras) {
  bool have_topics = true;
  for (size_t i = 0; i < cameras->size(); ++i) {
    have_topics = have_topics && !NameOfTopic(file, Key(i)).empty();
  }
  for (size_t i = 0; i < cameras->size(); ++i) {
    (*cameras)[i].image_name = have_topics ? NameOfTopic(file, Key(i)) : Key(i);
  }
}

std::string List(const std::vector<double>& values) {
  std::string text;
  for (const double value : values) {
    // A number without a point is an integer, which Kalibr refuses.
    std::string number = ExactNumber(value);
    if (number.find_first_of(".en") == std::string::npos) number += ".0";
    text += (text.empty() ? "" : ", ") + number;
  }
  return "[" + text + "]";
}

std::string WritePose(const Rigid3& previous, const Rigid3& pose) {
  const Eigen::Quaterniond q =
      (pose.rotation * previous.rotation.conjugate()).normalized();
  const Eigen::Matrix3d R = q.toRotationMatrix();
  const Eigen::Vector3d t = pose.translation - q * previous.translation;
  std::string text = "  T_cn_cnm1:\n";
  for (int row = 0; row < 3; ++row) {
    text += "  - " + List({R(row, 0), R(row, 1), R(row, 2), t(row)}) + "\n";
  }
  return text + "  - [0.0, 0.0, 0.0, 1.0]\n";
}

std::string WriteLens(const Lens& lens, double pixel_offset) {
  std::vector<double> distortion = lens.distortion;
  std::string model = "fov";
  if (lens.kind == Lens::Kind::kFisheye) {
    model = "equidistant";
  } else if (lens.kind == Lens::Kind::kBrown) {
    model = "radtan";
    distortion.resize(4);
  }
  return "  camera_model: pinhole\n  intrinsics: " +
         List({lens.fx,
               lens.fy,
               lens.cx - pixel_offset,
               lens.cy - pixel_offset}) +
         "\n  distortion_model: " + model +
         "\n  distortion_coeffs: " + List(distortion) + "\n";
}

}  // namespace

Cameras ReadKalibrRig(const std::string& path,
                      double pixel_offset,
                      RigRemarks* /*remarks*/) {
  const KalibrFile file(path);
  Cameras cameras;
  const size_t num_cameras = file.NumCameras();
  for (size_t i = 0; i < num_cameras; ++i) {
    KnownCamera camera;
    ReadPose(file, Key(i), i > 0 ? &cameras.back() : nullptr, &camera);
    ReadIntrinsics(file, Key(i), pixel_offset, &camera);
    cameras.push_back(std::move(camera));
  }
  NameCameras(file, &cameras);
  return cameras;
}

void WriteKalibrRig(const std::string& path,
                    const Cameras& cameras,
                    double pixel_offset,
                    RigRemarks* remarks) {
  LensFitter fitter("kalibr", 4, /*has_fisheye=*/true, /*has_fov=*/true);
  std::string text;
  for (size_t i = 0; i < cameras.size(); ++i) {
    const KnownCamera& camera = cameras[i];
    RequireIntrinsics("kalibr", camera);
    RequireImageSize("kalibr", camera);
    text += Key(i) + ":\n";
    if (i > 0) {
      text += WritePose(cameras[i - 1].cam_from_world, camera.cam_from_world);
    }
    text += WriteLens(fitter.Fit(camera), pixel_offset) + "  resolution: [" +
            std::to_string(camera.width) + ", " +
            std::to_string(camera.height) + "]\n  rostopic: /" +
            WrittenName(camera) + "/image_raw\n";
  }
  fitter.AddRemarks(remarks);
  remarks->push_back("kalibr holds no world: poses are relative to camera '" +
                     cameras.front().name +
                     "'; names are in rostopic, keys are cam0, cam1, ...");
  WriteRigFile(path, text);
}

}  // namespace mfir
