#include "colmap_ext/rigs/rig_io.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <system_error>

#include <Eigen/SVD>

#include "colmap_ext/host/reconstruction.h"
#include "colmap_ext/io/camera_models.h"
#include "colmap_ext/io/model_check.h"
#include "colmap_ext/io/model_io.h"
#include "colmap_ext/rigs/rig_formats.h"
#include "src/util/errors.h"
#include "src/util/parse_number.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

std::vector<KnownCamera> ReadColmapCameras(const std::string& path,
                                           double pixel_offset) {
  host::Reconstruction reconstruction;
  ReadModel(path, /*require_points=*/false, &reconstruction);
  std::vector<KnownCamera> cameras;
  for (const auto& [image_id, image] : reconstruction.Images()) {
    const host::Camera& colmap_camera = reconstruction.Camera(image.CameraId());
    KnownCamera camera;
    camera.image_name = image.Name();
    camera.cam_from_world = host::CamFromWorld(image);
    camera.model = FindCameraModel(host::ModelId(colmap_camera));
    camera.width = host::Width(colmap_camera);
    camera.height = host::Height(colmap_camera);
    camera.params = host::Params(colmap_camera);
    for (const size_t idx : camera.model->PrincipalPointIdxs()) {
      camera.params[idx] += pixel_offset;
    }
    cameras.push_back(std::move(camera));
  }
  return cameras;
}

std::string DetectFormat(const std::string& path) {
  std::error_code error;
  if (IsModelFolder(path)) {
    return "colmap";
  }
  if (IsOpenCVRig(path)) {
    return "opencv";
  }
  if (fs::is_regular_file(path, error)) {
    return "krt";
  }
  throw InputError(
      path +
      (fs::exists(path, error) ? ": not a known rig format"
                               : ": there is no such file or folder") +
      ". A rig is a folder with a COLMAP model (cameras and images, both .bin "
      "or both .txt), a folder with extri.yml and intri.yml (OpenCV, "
      "EasyMocap), or a KRT file.");
}

// COLMAP images are named by the rule for images; an image that it does not
// match, and everything in the formats that name cameras, is a camera name.
void NameCameras(const std::string& format,
                 const CameraNaming& naming,
                 std::vector<KnownCamera>* cameras) {
  std::vector<std::string> image_names;
  for (const KnownCamera& camera : *cameras) {
    image_names.push_back(camera.image_name);
  }
  std::vector<std::string> names(cameras->size());
  if (format == "colmap") {
    names = naming.Names(image_names);
  }
  for (size_t i = 0; i < cameras->size(); ++i) {
    (*cameras)[i].name =
        names[i].empty() ? naming.CameraName(image_names[i]) : names[i];
  }
}

void CheckCameras(const std::string& path,
                  const std::vector<KnownCamera>& cameras) {
  if (cameras.empty()) {
    throw InputError(path +
                     ": no camera in it. Give the rig with its known "
                     "extrinsics.");
  }
  for (size_t i = 1; i < cameras.size(); ++i) {
    if (cameras[i].name == cameras[i - 1].name) {
      throw InputError(path + ": '" + cameras[i - 1].image_name + "' and '" +
                       cameras[i].image_name + "' are both camera '" +
                       cameras[i].name +
                       "'. Remove one, or tell them apart by "
                       "--MultiFrame.camera_name_regex.");
    }
  }
}

}  // namespace

Rig ReadRig(const std::string& path,
            const std::string& format,
            const CameraNaming& naming,
            double pixel_offset) {
  Rig rig;
  rig.format = format.empty() || format == "auto" ? DetectFormat(path) : format;
  const auto offset_or = [pixel_offset](double default_offset) {
    return std::isnan(pixel_offset) ? default_offset : pixel_offset;
  };
  if (rig.format == "colmap") {
    rig.cameras = ReadColmapCameras(path, offset_or(0.0));
  } else if (rig.format == "krt") {
    rig.cameras = ReadKRTCameras(path, offset_or(0.0));
  } else if (rig.format == "opencv") {
    rig.cameras = ReadOpenCVCameras(path, offset_or(0.5));
  } else {
    throw UsageError("extrinsics_format '" + format +
                     "' is unknown: use auto, colmap, krt or opencv.");
  }
  NameCameras(rig.format, naming, &rig.cameras);
  std::sort(rig.cameras.begin(),
            rig.cameras.end(),
            [](const KnownCamera& a, const KnownCamera& b) {
              return a.name != b.name ? CameraNameLess(a.name, b.name)
                                      : a.image_name < b.image_name;
            });
  CheckCameras(path, rig.cameras);
  for (KnownCamera& camera : rig.cameras) {
    Eigen::Quaterniond& rotation = camera.cam_from_world.rotation;
    rotation = host::StableQuaternion(rotation);
  }
  return rig;
}

void CheckPixelOffset(const std::string& option, double pixel_offset) {
  constexpr double kMaxOffset = 1e4;
  if (std::abs(pixel_offset) > kMaxOffset) {
    throw UsageError(option + " " + FormatNumber(pixel_offset) +
                     " is in pixels and must be between -10000 and 10000 (nan: "
                     "0.5 for opencv, else 0).");
  }
}

void SetPose(const Eigen::Matrix<double, 3, 4>& matrix,
             const std::string& where,
             KnownCamera* camera) {
  const double kMaxDeviation = 1e-3;
  const Eigen::Matrix3d R = matrix.leftCols<3>();
  const std::string problem = CoordinateProblem(matrix.col(3));
  if (!problem.empty() || !R.allFinite()) {
    throw InputError(where + ": the " +
                     (problem.empty() ? "rotation is not finite"
                                      : "translation " + problem) +
                     ". Correct the numbers.");
  }
  const double deviation =
      (R.transpose() * R - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
  if (!(deviation <= kMaxDeviation) || R.determinant() < 0.0) {
    const std::string advice =
        deviation <= kMaxDeviation
            ? "The world of the file is mirrored (left-handed): change the "
              "signs of the third column of all cameras' R, which turns the "
              "world's z axis."
            : "Correct the numbers; rows are those of the camera's [R | t], "
              "x_camera = R x_world + t.";
    throw InputError(where +
                     ": the 3x3 matrix is not a rotation (R^T R differs "
                     "from the identity by " +
                     FormatNumber(deviation) + ", determinant " +
                     FormatNumber(R.determinant()) + "). " + advice);
  }
  // The nearest rotation: a quaternion cannot hold the rounding of R's digits.
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(
      R, Eigen::ComputeFullU | Eigen::ComputeFullV);
  camera->cam_from_world.rotation =
      Eigen::Quaterniond(svd.matrixU() * svd.matrixV().transpose())
          .normalized();
  camera->cam_from_world.translation = matrix.col(3);
  camera->matrix = matrix;
}

void SetIntrinsics(const Eigen::Matrix3d& K,
                   const std::vector<double>& distortion,
                   double pixel_offset,
                   const std::string& where,
                   KnownCamera* camera) {
  if (!(std::abs(K(0, 1)) <= 1e-6) || K(1, 0) != 0.0 || K(2, 0) != 0.0 ||
      K(2, 1) != 0.0 || K(2, 2) != 1.0) {
    throw InputError(where +
                     ": K must be fx 0 cx; 0 fy cy; 0 0 1. COLMAP's "
                     "cameras have no skew: correct K, or calibrate without "
                     "skew.");
  }
  const double values[] = {
      K(0, 0), K(1, 1), K(0, 2) + pixel_offset, K(1, 2) + pixel_offset};
  camera->params.assign(std::begin(values), std::end(values));
  camera->params.insert(
      camera->params.end(), distortion.begin(), distortion.end());
  // The smallest model that holds all coefficients that are not zero.
  size_t num_coefficients = distortion.size();
  while (num_coefficients > 0 && distortion[num_coefficients - 1] == 0.0) {
    --num_coefficients;
  }
  for (const char* name : {"PINHOLE", "OPENCV", "FULL_OPENCV"}) {
    camera->model = FindCameraModel(name);
    if (4 + num_coefficients <= camera->model->NumParams()) {
      camera->params.resize(camera->model->NumParams(), 0.0);
      const std::string problem =
          IntrinsicsProblem(*camera->model, camera->params);
      if (!problem.empty()) {
        throw InputError(where + ": " + problem + ". Correct the numbers.");
      }
      return;
    }
  }
  throw InputError(where +
                   ": distortion coefficients beyond k1 k2 p1 p2 k3 k4 "
                   "k5 k6 are not supported and must be 0.");
}

}  // namespace mfir
