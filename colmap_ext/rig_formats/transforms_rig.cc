#include <cmath>
#include <set>

#include "colmap_ext/io/input_file.h"
#include "colmap_ext/io/json_file.h"
#include "colmap_ext/rig_formats/camera_fields.h"
#include "colmap_ext/rig_formats/formats.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

// Fields of the frame, or of the whole file where it has none.
class Intrinsics {
 public:
  Intrinsics(const JsonValue& root, const JsonValue& frame)
      : root_(root), frame_(frame) {}

  std::optional<JsonValue> Find(const std::string& key) const {
    const std::optional<JsonValue> value = frame_.Find(key);
    return value ? value : root_.Find(key);
  }

  double Number(const std::string& key, double default_value) const {
    const std::optional<JsonValue> value = Find(key);
    return value ? value->Number() : default_value;
  }

 private:
  const JsonValue root_;
  const JsonValue frame_;
};

// "OPENCV", "OPENCV_FISHEYE" or "PINHOLE".
std::string ModelName(const Intrinsics& intrinsics) {
  const auto is_fisheye = intrinsics.Find("is_fisheye");  // instant-ngp
  if (is_fisheye && is_fisheye->Flag()) return "OPENCV_FISHEYE";
  const auto model = intrinsics.Find("camera_model");
  if (!model) return "OPENCV";
  std::string name = model->Text();
  if (name == "SIMPLE_PINHOLE") return "PINHOLE";
  if (name == "SIMPLE_RADIAL" || name == "RADIAL" || name == "FULL_OPENCV") {
    return "OPENCV";
  }
  if (name != "OPENCV" && name != "OPENCV_FISHEYE" && name != "PINHOLE") {
    model->Fail("'" + name +
                "' is not supported: OPENCV, OPENCV_FISHEYE and PINHOLE are");
  }
  return name;
}

// Focal length in pixels along an axis; 0 if the file gives none.
double FocalLength(const Intrinsics& intrinsics,
                   const std::string& axis,
                   size_t size) {
  const auto focal_length = intrinsics.Find("fl_" + axis);
  if (focal_length) return focal_length->Number();
  const auto angle = intrinsics.Find("camera_angle_" + axis);
  if (!angle || size == 0) return 0.0;
  return 0.5 * static_cast<double>(size) / std::tan(0.5 * angle->Number());
}

std::vector<double> Distortion(const std::string& model,
                               const Intrinsics& intrinsics) {
  const auto number = [&](const char* key) {
    return intrinsics.Number(key, 0.0);
  };
  if (model == "PINHOLE") return {};
  if (model == "OPENCV_FISHEYE") {
    for (const char* key : {"p1", "p2"}) {
      if (number(key) != 0.0) {
        intrinsics.Find(key)->Fail(
            "is not 0, but OPENCV_FISHEYE has no such parameter");
      }
    }
    return {number("k1"), number("k2"), number("k3"), number("k4")};
  }
  if (number("k4") != 0.0) {
    intrinsics.Find("k4")->Fail(
        "is not 0, but OPENCV has no such parameter (a fisheye lens needs "
        "camera_model OPENCV_FISHEYE)");
  }
  return {number("k1"), number("k2"), number("p1"), number("p2"), number("k3")};
}

void ReadIntrinsics(const Intrinsics& intrinsics,
                    double pixel_offset,
                    const std::string& where,
                    KnownCamera* camera) {
  if (const auto width = intrinsics.Find("w")) {
    camera->width = width->ImageSize();
  }
  if (const auto height = intrinsics.Find("h")) {
    camera->height = height->ImageSize();
  }
  Lens lens;
  lens.fx = FocalLength(intrinsics, "x", camera->width);
  lens.fy = FocalLength(intrinsics, "y", camera->height);
  if (lens.fx == 0.0) return;
  if (lens.fy == 0.0) lens.fy = lens.fx;
  if (camera->width == 0 && !(intrinsics.Find("cx") && intrinsics.Find("cy"))) {
    throw InputError(where +
                     ": neither w and h nor cx and cy are there. Add "
                     "the image size.");
  }
  // instant-ngp's default is the middle of the image.
  lens.cx = pixel_offset +
            intrinsics.Number("cx", 0.5 * static_cast<double>(camera->width));
  lens.cy = pixel_offset +
            intrinsics.Number("cy", 0.5 * static_cast<double>(camera->height));
  const std::string model = ModelName(intrinsics);
  lens.kind =
      model == "OPENCV_FISHEYE" ? Lens::Kind::kFisheye : Lens::Kind::kBrown;
  lens.distortion = Distortion(model, intrinsics);
  SetLens(lens, where, camera);
}

// OpenGL's camera axes (y up, z back) and COLMAP's differ by two signs.
Eigen::Matrix<double, 3, 4> WithOtherAxes(Eigen::Matrix<double, 3, 4> matrix) {
  matrix.col(1) *= -1.0;
  matrix.col(2) *= -1.0;
  return matrix;
}

void ReadPose(const JsonValue& transform, KnownCamera* camera) {
  const std::vector<double> values = transform.Numbers();
  if (values.size() != 16 && values.size() != 12) {
    transform.Fail("has " + std::to_string(values.size()) +
                   " numbers, not 4 x 4");
  }
  if (values.size() == 16 && (values[12] != 0.0 || values[13] != 0.0 ||
                              values[14] != 0.0 || values[15] != 1.0)) {
    transform.Fail("has another last row than 0 0 0 1");
  }
  const Eigen::Map<const Eigen::Matrix<double, 3, 4, Eigen::RowMajor>> matrix(
      values.data());
  SetPoseFromWorldFromCam(WithOtherAxes(matrix), transform.Where(), camera);
}

nlohmann::ordered_json WriteFrame(const KnownCamera& camera,
                                  const Lens& lens,
                                  double pixel_offset) {
  nlohmann::ordered_json frame = {{"file_path", WrittenImageName(camera)}};
  if (camera.width > 0) {
    frame["w"] = camera.width;
    frame["h"] = camera.height;
  }
  const bool is_fisheye = lens.kind == Lens::Kind::kFisheye;
  frame["camera_model"] = is_fisheye ? "OPENCV_FISHEYE" : "OPENCV";
  frame["fl_x"] = lens.fx;
  frame["fl_y"] = lens.fy;
  frame["cx"] = lens.cx - pixel_offset;
  frame["cy"] = lens.cy - pixel_offset;
  frame["k1"] = lens.distortion[0];
  frame["k2"] = lens.distortion[1];
  if (is_fisheye) {
    frame["k3"] = lens.distortion[2];
    frame["k4"] = lens.distortion[3];
  } else {
    frame["p1"] = lens.distortion[2];
    frame["p2"] = lens.distortion[3];
    frame["k3"] = lens.distortion[4];
  }
  const Eigen::Matrix<double, 3, 4> matrix =
      WithOtherAxes(WorldFromCamMatrix(camera));
  nlohmann::ordered_json rows = nlohmann::ordered_json::array();
  for (int row = 0; row < 3; ++row) {
    rows.push_back(
        {matrix(row, 0), matrix(row, 1), matrix(row, 2), matrix(row, 3)});
  }
  rows.push_back({0.0, 0.0, 0.0, 1.0});
  frame["transform_matrix"] = rows;
  return frame;
}

}  // namespace

Cameras ReadTransformsRig(const std::string& path,
                          double pixel_offset,
                          RigRemarks* remarks) {
  const nlohmann::json json = ParseJson(path, ReadTextFile(path));
  const JsonValue root(&json, path, "");
  Cameras cameras;
  for (const JsonValue& frame : root.At("frames").Elements()) {
    KnownCamera camera;
    const std::string file_path = frame.At("file_path").Text();
    camera.image_name =
        file_path.compare(0, 2, "./") == 0 ? file_path.substr(2) : file_path;
    ReadPose(frame.At("transform_matrix"), &camera);
    ReadIntrinsics(
        Intrinsics(root, frame), pixel_offset, frame.Where(), &camera);
    cameras.push_back(std::move(camera));
  }
  if (root.Find("applied_transform") || root.Find("applied_scale")) {
    remarks->push_back(path +
                       ": poses are taken in the coordinates of the file; "
                       "applied_transform and applied_scale are not undone");
  }
  return cameras;
}

void WriteTransformsRig(const std::string& path,
                        const Cameras& cameras,
                        double pixel_offset,
                        RigRemarks* remarks) {
  LensFitter fitter("transforms", 5, /*has_fisheye=*/true);
  nlohmann::ordered_json frames = nlohmann::ordered_json::array();
  std::set<std::string> models;
  for (const KnownCamera& camera : cameras) {
    RequireIntrinsics("transforms", camera);
    frames.push_back(WriteFrame(camera, fitter.Fit(camera), pixel_offset));
    models.insert(frames.back()["camera_model"]);
  }
  fitter.AddRemarks(remarks);
  nlohmann::ordered_json json;
  if (models.size() == 1) {
    json["camera_model"] = *models.begin();
  } else {
    remarks->push_back(
        "transforms: some cameras are OPENCV, some OPENCV_FISHEYE, which each "
        "frame says; nerfstudio reads one camera_model for all");
  }
  json["frames"] = frames;
  WriteRigFile(path, json.dump(2) + "\n");
}

}  // namespace mfir
