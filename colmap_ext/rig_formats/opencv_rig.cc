#include <cmath>
#include <filesystem>
#include <optional>
#include <set>
#include <string>
#include <system_error>

#include <Eigen/Geometry>
#include <opencv2/core.hpp>

#include "colmap_ext/io/quiet_opencv.h"
#include "colmap_ext/rig_formats/camera_fields.h"
#include "colmap_ext/rig_formats/formats.h"
#include "colmap_ext/rig_formats/yaml_file.h"
#include "src/sensor/camera_naming.h"
#include "src/util/errors.h"
#include "src/util/parse_number.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

bool IsFile(const fs::path& path) {
  std::error_code error;
  return fs::is_regular_file(path, error);
}

// Fields "PREFIX_CAMERA" of a file in OpenCV's YAML. OpenCV's own reader can
// hang on damaged files.
class OpenCVFile {
 public:
  explicit OpenCVFile(const std::string& path)
      : path_(path), root_(ReadYamlFile(path)) {
    if (!root_.IsMap()) {
      throw InputError(path +
                       ": not a file in OpenCV's YAML, which has names and "
                       "fields like K_1 or T_1 at its top level.");
    }
    for (const auto& entry : root_) {
      const std::string field = entry.first.as<std::string>("");
      if (!fields_.insert(field).second) Fail(field, "stands twice");
    }
  }

  const std::string& Path() const { return path_; }

  std::vector<std::string> CameraNames() const {
    std::vector<std::string> names;
    const YAML::Node node = root_["names"];
    if (!node.IsDefined() || !node.IsSequence()) {
      Fail("names", "is missing or not a list of camera names");
    }
    for (const YAML::Node& name : node) {
      if (!name.IsScalar() || name.Scalar().empty()) {
        Fail("names", "has an entry that is not a camera name");
      }
      names.push_back(name.Scalar());
    }
    return names;
  }

  // The field of a camera, if there is one. Numbers compare as numbers: the
  // list may have 1 where the field has 01.
  std::optional<std::string> FindField(const std::string& prefix,
                                       const std::string& camera_name) const {
    const std::string canonical_name = CanonicalCameraName(camera_name);
    for (auto field = fields_.lower_bound(prefix);
         field != fields_.end() &&
         field->compare(0, prefix.size(), prefix) == 0;
         ++field) {
      if (CanonicalCameraName(field->substr(prefix.size())) == canonical_name) {
        return *field;
      }
    }
    return std::nullopt;
  }

  // Row-major elements of an opencv-matrix.
  std::vector<double> Matrix(const std::string& field) const {
    const YAML::Node node = root_[field];
    if (!node.IsMap() || !node["data"].IsDefined() ||
        !node["data"].IsSequence()) {
      Fail(field, "is not an opencv-matrix");
    }
    std::vector<double> values;
    for (const YAML::Node& element : node["data"]) {
      double value;
      if (!element.IsScalar() || !ParseNumber(element.Scalar(), &value) ||
          !std::isfinite(value)) {
        Fail(field,
             "element " + std::to_string(values.size() + 1) +
                 " is not a finite number");
      }
      values.push_back(value);
    }
    return values;
  }

  std::vector<double> Matrix(const std::string& field, size_t size) const {
    std::vector<double> values = Matrix(field);
    if (values.size() != size) {
      Fail(field,
           "has " + std::to_string(values.size()) + " elements, not " +
               std::to_string(size));
    }
    return values;
  }

  // Width or height; 0 where it is missing or, as EasyMocap writes, -1.
  size_t ImageSize(const std::string& prefix,
                   const std::string& camera_name) const {
    const std::optional<std::string> field = FindField(prefix, camera_name);
    if (!field) {
      return 0;
    }
    const YAML::Node node = root_[*field];
    double size;
    if (!node.IsScalar() || !ParseNumber(node.Scalar(), &size)) {
      size = std::nan("");
    }
    if (size == -1.0) {
      return 0;
    }
    if (!(size >= 1.0 && size <= 1e6) || size != std::floor(size)) {
      Fail(*field, "is not an image size in pixels");
    }
    return static_cast<size_t>(size);
  }

  [[noreturn]] void Fail(const std::string& field,
                         const std::string& what) const {
    throw InputError(path_ + ": " + field + " " + what +
                     ". Correct the field, or export the calibration again.");
  }

 private:
  const std::string path_;
  const YAML::Node root_;
  std::set<std::string> fields_;
};

Eigen::Matrix3d RowMajorMatrix3(const std::vector<double>& values) {
  return Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(
      values.data());
}

void ReadPose(const OpenCVFile& file, KnownCamera* camera) {
  const std::string& name = camera->image_name;
  const auto rotation_field = file.FindField("Rot_", name);
  const auto rotation_vector_field = file.FindField("R_", name);
  const auto translation_field = file.FindField("T_", name);
  if (!translation_field) {
    file.Fail("T_" + name, "(translation) is missing");
  }
  if (!rotation_field && !rotation_vector_field) {
    file.Fail("Rot_" + name,
              "(rotation matrix) and R_" + name +
                  " (rotation vector) are both missing");
  }

  Eigen::Matrix3d rotation_of_vector = Eigen::Matrix3d::Identity();
  if (rotation_vector_field) {
    const std::vector<double> vector = file.Matrix(*rotation_vector_field, 3);
    const Eigen::Map<const Eigen::Vector3d> angle_axis(vector.data());
    if (angle_axis.norm() > 0.0) {
      rotation_of_vector =
          Eigen::AngleAxisd(angle_axis.norm(), angle_axis.normalized())
              .toRotationMatrix();
    }
  }
  const std::vector<double> translation = file.Matrix(*translation_field, 3);
  Eigen::Matrix<double, 3, 4> matrix;
  matrix.leftCols<3>() = rotation_field
                             ? RowMajorMatrix3(file.Matrix(*rotation_field, 9))
                             : rotation_of_vector;
  matrix.col(3) = Eigen::Map<const Eigen::Vector3d>(translation.data());
  SetPose(matrix, file.Path() + ": camera " + name, camera);
  if (!rotation_field) {
    camera->matrix.reset();  // the file gives none
  } else if (rotation_vector_field &&
             (matrix.leftCols<3>() - rotation_of_vector).norm() > 1e-3) {
    file.Fail(*rotation_field,
              "and " + *rotation_vector_field +
                  " are different rotations; keep the right one");
  }
}

void ReadIntrinsics(const OpenCVFile& file,
                    double pixel_offset,
                    KnownCamera* camera) {
  const std::string& name = camera->image_name;
  const auto K_field = file.FindField("K_", name);
  if (!K_field) {
    file.Fail("K_" + name, "(camera matrix) is missing");
  }
  const Eigen::Matrix3d K = RowMajorMatrix3(file.Matrix(*K_field, 9));
  // EasyMocap reads both names.
  auto distortion_field = file.FindField("dist_", name);
  if (!distortion_field) {
    distortion_field = file.FindField("D_", name);
  }
  const std::vector<double> distortion =
      distortion_field ? file.Matrix(*distortion_field) : std::vector<double>();
  SetIntrinsics(
      K, distortion, pixel_offset, file.Path() + ": camera " + name, camera);
  camera->width = file.ImageSize("W_", name);
  camera->height = file.ImageSize("H_", name);
}

bool IsYamlFile(const fs::path& path) {
  return IsFile(path) &&
         (path.extension() == ".yml" || path.extension() == ".yaml");
}

// extri.yml and intri.yml for what the user gave, intri.yml empty if missing.
std::pair<fs::path, fs::path> FindFiles(const fs::path& path) {
  std::error_code error;
  const bool is_half_of_pair =
      path.filename() == "extri.yml" || path.filename() == "intri.yml";
  if (IsYamlFile(path) && !is_half_of_pair) {
    return {path, path};
  }
  const fs::path folder =
      fs::is_directory(path, error) ? path : path.parent_path();
  const fs::path extrinsics = folder / "extri.yml";
  const fs::path intrinsics = folder / "intri.yml";
  if (!IsFile(extrinsics)) {
    throw InputError(extrinsics.string() +
                     ": there is no such file. An OpenCV rig is a folder with "
                     "extri.yml and intri.yml.");
  }
  return {extrinsics, IsFile(intrinsics) ? intrinsics : fs::path()};
}

cv::FileStorage OpenToWrite(const char* name) {
  return {name,
          cv::FileStorage::WRITE | cv::FileStorage::MEMORY |
              cv::FileStorage::FORMAT_YAML};
}

void WriteNames(const Cameras& cameras, cv::FileStorage* file) {
  *file << "names"
        << "[";
  for (const KnownCamera& camera : cameras) *file << WrittenName(camera);
  *file << "]";
}

template <typename Matrix>
cv::Mat RowMajor(const Matrix& matrix) {
  cv::Mat result(
      static_cast<int>(matrix.rows()), static_cast<int>(matrix.cols()), CV_64F);
  for (int row = 0; row < result.rows; ++row) {
    for (int col = 0; col < result.cols; ++col) {
      result.at<double>(row, col) = matrix(row, col);
    }
  }
  return result;
}

void WriteIntrinsics(const KnownCamera& camera,
                     Lens lens,
                     double pixel_offset,
                     cv::FileStorage* file) {
  const std::string name = WrittenName(camera);
  std::vector<double>& distortion = lens.distortion;
  // EasyMocap takes 5.
  if (distortion[5] == 0.0 && distortion[6] == 0.0 && distortion[7] == 0.0) {
    distortion.resize(5);
  }
  *file << "K_" + name << RowMajor(lens.K(pixel_offset));
  *file << "dist_" + name << cv::Mat(distortion, /*copyData=*/true).t();
  if (camera.width > 0) {
    *file << "W_" + name << static_cast<int>(camera.width);
    *file << "H_" + name << static_cast<int>(camera.height);
  }
}

void WritePose(const KnownCamera& camera, cv::FileStorage* file) {
  const std::string name = WrittenName(camera);
  const Eigen::Matrix<double, 3, 4> pose = PoseMatrix(camera);
  const Eigen::AngleAxisd angle_axis(
      camera.cam_from_world.rotation.normalized());
  const Eigen::Vector3d rotation = angle_axis.angle() * angle_axis.axis();
  *file << "R_" + name << RowMajor(rotation);
  *file << "Rot_" + name << RowMajor(pose.leftCols<3>());
  *file << "T_" + name << RowMajor(pose.col(3));
}

}  // namespace

bool IsOpenCVRig(const std::string& path) {
  return IsFile(fs::path(path) / "extri.yml") ||
         IsFile(fs::path(path) / "intri.yml") || IsYamlFile(path);
}

Cameras ReadOpenCVRig(const std::string& path,
                      double pixel_offset,
                      RigRemarks* /*remarks*/) {
  const auto [extrinsics_path, intrinsics_path] = FindFiles(path);
  const OpenCVFile extrinsics(extrinsics_path.string());
  Cameras cameras;
  for (const std::string& name : extrinsics.CameraNames()) {
    KnownCamera& camera = cameras.emplace_back();
    camera.image_name = name;
    ReadPose(extrinsics, &camera);
  }
  if (intrinsics_path.empty()) return cameras;
  const OpenCVFile intrinsics(intrinsics_path.string());
  for (KnownCamera& camera : cameras) {
    ReadIntrinsics(intrinsics, pixel_offset, &camera);
  }
  return cameras;
}

void WriteOpenCVRig(const std::string& path,
                    const Cameras& cameras,
                    double pixel_offset,
                    RigRemarks* remarks) {
  const QuietOpenCV quiet_opencv;
  LensFitter fitter("opencv", 8, /*has_fisheye=*/false);
  std::error_code ignored;
  fs::create_directories(path, ignored);
  try {
    cv::FileStorage intrinsics = OpenToWrite("intri.yml");
    cv::FileStorage extrinsics = OpenToWrite("extri.yml");
    WriteNames(cameras, &intrinsics);
    WriteNames(cameras, &extrinsics);
    for (const KnownCamera& camera : cameras) {
      RequireIntrinsics("opencv", camera);
      WriteIntrinsics(camera, fitter.Fit(camera), pixel_offset, &intrinsics);
      WritePose(camera, &extrinsics);
    }
    fitter.AddRemarks(remarks);
    WriteRigFile((fs::path(path) / "intri.yml").string(),
                 intrinsics.releaseAndGetString());
    WriteRigFile((fs::path(path) / "extri.yml").string(),
                 extrinsics.releaseAndGetString());
  } catch (const cv::Exception& error) {
    throw OutputError(path + ": cannot be written in OpenCV's YAML (" +
                      error.err +
                      "). Camera names may have letters, digits, '_' and '-' "
                      "only there.");
  }
}

}  // namespace mfir
