#include <cmath>
#include <map>
#include <sstream>

#include <pugixml.hpp>

#include "colmap_ext/io/input_file.h"
#include "colmap_ext/rig_formats/camera_fields.h"
#include "colmap_ext/rig_formats/formats.h"
#include "src/util/errors.h"
#include "src/util/parse_number.h"

namespace mfir {
namespace {

using Matrix34 = Eigen::Matrix<double, 3, 4>;

// An element and how messages call it: "FILE: camera 'cam00'/transform".
class Element {
 public:
  Element(const pugi::xml_node& node, const std::string& where)
      : node_(node), where_(where) {}

  bool Exists() const { return !node_.empty(); }
  const std::string& Where() const { return where_; }
  const pugi::xml_node& Node() const { return node_; }

  Element Child(const char* name) const {
    return {node_.child(name), where_ + "/" + name};
  }

  std::vector<double> Numbers(size_t size) const {
    if (!Exists()) Fail("is missing");
    std::istringstream text(node_.child_value());
    std::vector<double> numbers;
    for (std::string token; text >> token;) {
      double value;
      if (!ParseNumber(token, &value) || !std::isfinite(value)) {
        Fail("has '" + token.substr(0, 40) + "', which is no finite number");
      }
      numbers.push_back(value);
    }
    if (numbers.size() != size) {
      Fail("has " + std::to_string(numbers.size()) + " numbers, not " +
           std::to_string(size));
    }
    return numbers;
  }

  // The number of a child, 0 if there is none.
  double NumberOrZero(const char* name) const {
    const Element child = Child(name);
    return child.Exists() ? child.Numbers(1).front() : 0.0;
  }

  size_t ImageSize(const char* attribute) const {
    double size = 0.0;
    if (!ParseNumber(std::string(node_.attribute(attribute).value()), &size) ||
        !(size >= 1.0 && size <= 1e6) || size != std::floor(size)) {
      Fail(std::string(attribute) + " is not an image size in pixels");
    }
    return static_cast<size_t>(size);
  }

  [[noreturn]] void Fail(const std::string& what) const {
    throw InputError(where_ + " " + what +
                     ". Correct it, or export the cameras again (File > Export "
                     "> Export Cameras, Agisoft XML).");
  }

 private:
  pugi::xml_node node_;
  std::string where_;
};

// The file's transform of a chunk or component to the world:
// x_world = scale * rotation * x + translation; the identity if it has none.
Similarity3 ReadSimilarity(const Element& transform) {
  Similarity3 world;
  if (!transform.Exists()) return world;
  if (transform.Child("rotation").Exists()) {
    Matrix34 matrix = Matrix34::Zero();
    const std::vector<double> R = transform.Child("rotation").Numbers(9);
    matrix.leftCols<3>() =
        Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(
            R.data());
    KnownCamera checked;
    SetPose(matrix, transform.Child("rotation").Where(), &checked);
    world.rotation = checked.cam_from_world.rotation;
  }
  if (transform.Child("translation").Exists()) {
    const std::vector<double> t = transform.Child("translation").Numbers(3);
    world.translation = Eigen::Vector3d(t[0], t[1], t[2]);
  }
  if (transform.Child("scale").Exists()) {
    world.scale = transform.Child("scale").Numbers(1).front();
    if (!(world.scale > 0.0)) transform.Child("scale").Fail("is not positive");
  }
  return world;
}

bool IsIdentity(const Similarity3& similarity) {
  return similarity.scale == 1.0 && similarity.translation.isZero() &&
         similarity.rotation.isApprox(Eigen::Quaterniond::Identity());
}

// Metashape's model (manual, appendix "Camera models"):
//   x' = x (1 + K1 r^2 + K2 r^4 + K3 r^6 + K4 r^8)
//        + P1 (r^2 + 2 x^2) + 2 P2 x y,
//   y' = y (...) + P2 (r^2 + 2 y^2) + 2 P1 x y,
//   u = width / 2 + cx + x' (f + B1) + y' B2,
//   v = height / 2 + cy + y' f,
// where (0.5, 0.5) is the centre of the top-left pixel. OpenCV's p1 is P2, and
// p2 is P1.
Lens ReadLens(const Element& sensor,
              const Element& calibration,
              size_t width,
              size_t height) {
  const std::string type = calibration.Node().attribute("type").value();
  const bool is_fisheye = type == "fisheye" || type == "equidistant_fisheye";
  if (!is_fisheye && type != "frame" && !type.empty()) {
    sensor.Fail("has the camera type '" + type +
                "', for which COLMAP has no model: frame and fisheye are "
                "supported");
  }
  const double f = calibration.Child("f").Numbers(1).front();
  Lens lens;
  lens.fx = f + calibration.NumberOrZero("b1");
  lens.fy = f;
  lens.cx = 0.5 * static_cast<double>(width) + calibration.NumberOrZero("cx");
  lens.cy = 0.5 * static_cast<double>(height) + calibration.NumberOrZero("cy");
  const double k[4] = {calibration.NumberOrZero("k1"),
                       calibration.NumberOrZero("k2"),
                       calibration.NumberOrZero("k3"),
                       calibration.NumberOrZero("k4")};
  std::vector<const char*> without_counterpart = {"b2", "p3", "p4"};
  if (is_fisheye) {
    lens.kind = Lens::Kind::kFisheye;
    lens.distortion = {k[0], k[1], k[2], k[3]};
    without_counterpart.insert(without_counterpart.end(), {"p1", "p2"});
  } else {
    lens.distortion = {k[0],
                       k[1],
                       calibration.NumberOrZero("p2"),
                       calibration.NumberOrZero("p1"),
                       k[2]};
    without_counterpart.push_back("k4");
  }
  for (const char* name : without_counterpart) {
    if (std::abs(calibration.NumberOrZero(name)) > 1e-12) {
      calibration.Child(name).Fail(
          "is not 0, and no camera model of COLMAP has such a parameter: "
          "optimise the cameras without it");
    }
  }
  return lens;
}

// Sets size and lens of a camera from those of its sensor.
void ReadSensor(const Element& sensor,
                double pixel_offset,
                const std::string& where,
                KnownCamera* camera) {
  Element calibration(pugi::xml_node(), sensor.Where() + "/calibration");
  for (const pugi::xml_node& node : sensor.Node().children("calibration")) {
    const bool is_adjusted =
        std::string(node.attribute("class").value()) == "adjusted";
    if (!calibration.Exists() || is_adjusted) {
      calibration = Element(node, calibration.Where());
    }
  }
  Element resolution = sensor.Child("resolution");
  if (!resolution.Exists()) resolution = calibration.Child("resolution");
  if (!resolution.Exists()) sensor.Fail("has no resolution");
  camera->width = resolution.ImageSize("width");
  camera->height = resolution.ImageSize("height");
  if (!calibration.Exists()) return;
  Lens lens = ReadLens(sensor, calibration, camera->width, camera->height);
  lens.cx += pixel_offset;
  lens.cy += pixel_offset;
  SetLens(lens, where, camera);
}

class MetashapeFile {
 public:
  explicit MetashapeFile(const std::string& path) : path_(path) {
    const std::string text = ReadTextFile(path);
    const pugi::xml_parse_result result =
        document_.load_buffer(text.data(), text.size());
    if (!result) {
      // It can lie behind the end.
      const auto end =
          std::min(static_cast<size_t>(result.offset), text.size());
      const auto line = 1 + std::count(text.begin(), text.begin() + end, '\n');
      throw InputError(path + ":" + std::to_string(line) +
                       ": not valid XML: " + result.description() +
                       ". Correct the line, or export the file again.");
    }
    chunk_ = document_.child("document").child("chunk");
    if (!chunk_) {
      throw InputError(path +
                       ": there is no document/chunk in it, so it is no export "
                       "of Metashape's cameras. Export them as Agisoft XML.");
    }
    if (chunk_.next_sibling("chunk")) {
      throw InputError(path +
                       " has several chunks. Export the cameras of one.");
    }
    world_from_chunk_ =
        ReadSimilarity({chunk_.child("transform"), path + ": transform"});
  }

  // Whether a transform to the world moves the cameras.
  bool HasWorld() const {
    if (!IsIdentity(world_from_chunk_)) return true;
    for (const pugi::xml_node& component :
         chunk_.child("components").children("component")) {
      if (!IsIdentity(ReadSimilarity({component.child("transform"), path_}))) {
        return true;
      }
    }
    return false;
  }

  // Also in groups. Those without a pose are counted.
  Cameras ReadCameras(double pixel_offset, size_t* num_without_pose) const {
    Cameras cameras;
    for (const pugi::xpath_node& found :
         chunk_.child("cameras").select_nodes(".//camera")) {
      const pugi::xml_node node = found.node();
      const std::string label = node.attribute("label").value();
      const Element element(node, path_ + ": camera '" + label + "'");
      if (label.empty()) element.Fail("has no label");
      if (!node.child("transform")) {
        ++*num_without_pose;
        continue;
      }
      cameras.push_back(ReadCamera(element, label, pixel_offset));
    }
    return cameras;
  }

 private:
  pugi::xml_node FindById(const char* list,
                          const char* name,
                          const std::string& id) const {
    return chunk_.child(list).find_child_by_attribute(name, "id", id.c_str());
  }

  KnownCamera ReadCamera(const Element& element,
                         const std::string& label,
                         double pixel_offset) const {
    KnownCamera camera;
    camera.image_name = label;
    const std::vector<double> values = element.Child("transform").Numbers(16);
    Matrix34 matrix =
        Eigen::Map<const Eigen::Matrix<double, 3, 4, Eigen::RowMajor>>(
            values.data());
    const pugi::xml_node component =
        FindById("components",
                 "component",
                 element.Node().attribute("component_id").value());
    const Similarity3 world =
        component.child("transform")
            ? ReadSimilarity({component.child("transform"),
                              path_ + ": component/transform"})
            : world_from_chunk_;
    // The scale has no meaning for the axes of the camera.
    const Eigen::Vector3d center = world * Eigen::Vector3d(matrix.col(3));
    matrix.leftCols<3>() =
        world.rotation.toRotationMatrix() * matrix.leftCols<3>();
    matrix.col(3) = center;
    SetPoseFromWorldFromCam(matrix, element.Where() + "/transform", &camera);
    const std::string sensor_id = element.Node().attribute("sensor_id").value();
    const Element sensor(FindById("sensors", "sensor", sensor_id),
                         path_ + ": sensor " + sensor_id);
    if (!sensor.Exists()) {
      element.Fail("has the sensor_id '" + sensor_id + "', which is not there");
    }
    ReadSensor(sensor, pixel_offset, element.Where(), &camera);
    return camera;
  }

  const std::string path_;
  pugi::xml_document document_;
  pugi::xml_node chunk_;
  Similarity3 world_from_chunk_;
};

void AppendText(pugi::xml_node* parent,
                const char* name,
                const std::string& text) {
  parent->append_child(name).text().set(text.c_str());
}

void AppendResolution(const KnownCamera& camera, pugi::xml_node* parent) {
  pugi::xml_node node = parent->append_child("resolution");
  node.append_attribute("width") = static_cast<unsigned>(camera.width);
  node.append_attribute("height") = static_cast<unsigned>(camera.height);
}

void AppendSensor(const KnownCamera& camera,
                  const Lens& lens,
                  double pixel_offset,
                  unsigned id,
                  pugi::xml_node* sensors) {
  const bool is_fisheye = lens.kind == Lens::Kind::kFisheye;
  const char* type = is_fisheye ? "fisheye" : "frame";
  pugi::xml_node sensor = sensors->append_child("sensor");
  sensor.append_attribute("id") = id;
  sensor.append_attribute("label") = WrittenName(camera).c_str();
  sensor.append_attribute("type") = type;
  AppendResolution(camera, &sensor);
  pugi::xml_node calibration = sensor.append_child("calibration");
  calibration.append_attribute("type") = type;
  calibration.append_attribute("class") = "adjusted";
  AppendResolution(camera, &calibration);
  const std::vector<double>& d = lens.distortion;
  std::vector<std::pair<const char*, double>> values = {
      {"f", lens.fy},
      {"cx", lens.cx - pixel_offset - 0.5 * static_cast<double>(camera.width)},
      {"cy", lens.cy - pixel_offset - 0.5 * static_cast<double>(camera.height)},
      {"b1", lens.fx - lens.fy},
      {"k1", d[0]},
      {"k2", d[1]}};
  if (is_fisheye) {
    values.insert(values.end(), {{"k3", d[2]}, {"k4", d[3]}});
  } else {
    values.insert(values.end(), {{"k3", d[4]}, {"p1", d[3]}, {"p2", d[2]}});
  }
  for (const auto& [name, value] : values) {
    AppendText(&calibration, name, ExactNumber(value));
  }
}

}  // namespace

Cameras ReadMetashapeRig(const std::string& path,
                         double pixel_offset,
                         RigRemarks* remarks) {
  const MetashapeFile file(path);
  size_t num_without_pose = 0;
  Cameras cameras = file.ReadCameras(pixel_offset, &num_without_pose);
  if (num_without_pose > 0) {
    remarks->push_back(path + ": " + std::to_string(num_without_pose) +
                       " cameras are not aligned (no transform) and left out");
  }
  if (file.HasWorld()) {
    remarks->push_back(path +
                       ": poses are taken to the world by the transform of the "
                       "chunk or component");
  }
  return cameras;
}

void WriteMetashapeRig(const std::string& path,
                       const Cameras& cameras,
                       double pixel_offset,
                       RigRemarks* remarks) {
  LensFitter fitter("metashape", 5, /*has_fisheye=*/true);
  pugi::xml_document document;
  pugi::xml_node root = document.append_child("document");
  root.append_attribute("version") = "1.5.0";
  pugi::xml_node chunk = root.append_child("chunk");
  chunk.append_attribute("label") = "rig";
  chunk.append_attribute("enabled") = "true";
  pugi::xml_node sensors = chunk.append_child("sensors");
  pugi::xml_node list = chunk.append_child("cameras");
  for (size_t i = 0; i < cameras.size(); ++i) {
    const KnownCamera& camera = cameras[i];
    RequireIntrinsics("metashape", camera);
    RequireImageSize("metashape", camera);
    const auto id = static_cast<unsigned>(i);
    AppendSensor(camera, fitter.Fit(camera), pixel_offset, id, &sensors);
    pugi::xml_node node = list.append_child("camera");
    node.append_attribute("id") = id;
    node.append_attribute("sensor_id") = id;
    node.append_attribute("label") = WrittenImageName(camera).c_str();
    node.append_attribute("enabled") = "true";
    const Matrix34 matrix = WorldFromCamMatrix(camera);
    std::string text;
    for (int row = 0; row < 3; ++row) {
      for (int col = 0; col < 4; ++col) {
        text += ExactNumber(matrix(row, col)) + " ";
      }
    }
    AppendText(&node, "transform", text + "0 0 0 1");
  }
  fitter.AddRemarks(remarks);
  std::ostringstream text;
  document.save(text, "  ");
  WriteRigFile(path, text.str());
}

}  // namespace mfir
