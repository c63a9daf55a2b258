#include "colmap_ext/rig_formats/camera_fields.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <sstream>

#include <Eigen/SVD>

#include "colmap_ext/host/util.h"
#include "colmap_ext/models/camera_models.h"
#include "colmap_ext/models/model_check.h"
#include "src/sensor/camera_conversion.h"
#include "src/sensor/camera_naming.h"
#include "src/sensor/image_name.h"
#include "src/util/errors.h"
#include "src/util/parse_number.h"

namespace mfir {
namespace {

constexpr size_t kNumBrown = 8;
constexpr size_t kNumFisheye = 4;

std::vector<double> Padded(std::vector<double> values, size_t size) {
  values.resize(std::max(size, values.size()), 0.0);
  return values;
}

// Coefficients up to the last that is not zero.
size_t NumUsed(const std::vector<double>& coefficients) {
  size_t num_used = coefficients.size();
  while (num_used > 0 && coefficients[num_used - 1] == 0.0) --num_used;
  return num_used;
}

void SetModel(const char* name,
              const Lens& lens,
              const std::string& where,
              KnownCamera* camera) {
  camera->model = FindCameraModel(name);
  camera->params = {lens.fx, lens.fy, lens.cx, lens.cy};
  camera->params.insert(
      camera->params.end(), lens.distortion.begin(), lens.distortion.end());
  camera->params.resize(camera->model->NumParams(), 0.0);
  const std::string problem = IntrinsicsProblem(*camera->model, camera->params);
  if (!problem.empty()) {
    throw InputError(where + ": " + problem + ". Correct the numbers.");
  }
}

// Largest distance between the projections of the same rays, on a grid of
// pixels.
double MaxDifference(const KnownCamera& a, const KnownCamera& b) {
  constexpr int kNumSteps = 8;
  double max_difference = 0.0;
  for (int i = 0; i <= kNumSteps; ++i) {
    for (int j = 0; j <= kNumSteps; ++j) {
      const double x = static_cast<double>(a.width) * i / kNumSteps;
      const double y = static_cast<double>(a.height) * j / kNumSteps;
      double uv[2], xy[2];
      a.model->Unproject(a.params.data(), x, y, uv);
      b.model->Project(b.params.data(), uv[0], uv[1], xy);
      max_difference =
          std::max(max_difference, std::hypot(xy[0] - x, xy[1] - y));
    }
  }
  return max_difference;
}

}  // namespace

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

void SetPoseFromWorldFromCam(const Eigen::Matrix<double, 3, 4>& world_from_cam,
                             const std::string& where,
                             KnownCamera* camera) {
  // Checked as it is, so that a message fits the numbers of the file.
  SetPose(world_from_cam, where, camera);
  Rigid3& pose = camera->cam_from_world;
  const Eigen::Vector3d center = pose.translation;
  pose.rotation = pose.rotation.conjugate();
  pose.translation = -(pose.rotation * center);
  camera->matrix.reset();
}

Eigen::Matrix<double, 3, 4> PoseMatrix(const KnownCamera& camera) {
  if (camera.matrix) return *camera.matrix;
  Eigen::Matrix<double, 3, 4> matrix;
  matrix << camera.cam_from_world.rotation.normalized().toRotationMatrix(),
      camera.cam_from_world.translation;
  return matrix;
}

Eigen::Matrix<double, 3, 4> WorldFromCamMatrix(const KnownCamera& camera) {
  Eigen::Matrix<double, 3, 4> matrix;
  matrix << camera.cam_from_world.rotation.normalized()
                .toRotationMatrix()
                .transpose(),
      camera.cam_from_world.Center();
  return matrix;
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
  SetLens({Lens::Kind::kBrown,
           K(0, 0),
           K(1, 1),
           K(0, 2) + pixel_offset,
           K(1, 2) + pixel_offset,
           distortion},
          where,
          camera);
}

Eigen::Matrix3d Lens::K(double pixel_offset) const {
  Eigen::Matrix3d K;
  K << fx, 0.0, cx - pixel_offset, 0.0, fy, cy - pixel_offset, 0.0, 0.0, 1.0;
  return K;
}

Lens LensOf(const KnownCamera& camera) {
  const CameraModel& model = *camera.model;
  Lens lens;
  lens.fx = camera.params[model.FocalLengthIdxs().front()];
  lens.fy = camera.params[model.FocalLengthIdxs().back()];
  lens.cx = camera.params[model.PrincipalPointIdxs()[0]];
  lens.cy = camera.params[model.PrincipalPointIdxs()[1]];
  for (const size_t idx : model.ExtraParamsIdxs()) {
    lens.distortion.push_back(camera.params[idx]);
  }
  const std::string& name = model.Name();
  if (name == "SIMPLE_PINHOLE" || name == "PINHOLE" ||
      name == "SIMPLE_RADIAL" || name == "RADIAL" || name == "OPENCV" ||
      name == "FULL_OPENCV") {
    // All of these begin with k1, k2.
    lens.distortion = Padded(lens.distortion, kNumBrown);
  } else if (name == "SIMPLE_RADIAL_FISHEYE" || name == "RADIAL_FISHEYE" ||
             name == "OPENCV_FISHEYE") {
    lens.kind = Lens::Kind::kFisheye;
    lens.distortion = Padded(lens.distortion, kNumFisheye);
  } else if (name == "FOV") {
    lens.kind = Lens::Kind::kFov;
  } else {
    lens.kind = Lens::Kind::kOther;
    lens.distortion.clear();
  }
  return lens;
}

void SetLens(const Lens& lens, const std::string& where, KnownCamera* camera) {
  if (lens.kind == Lens::Kind::kFisheye) {
    SetModel("OPENCV_FISHEYE", lens, where, camera);
    return;
  }
  if (lens.kind == Lens::Kind::kFov) {
    SetModel("FOV", lens, where, camera);
    return;
  }
  Lens shortened = lens;
  shortened.distortion.resize(NumUsed(lens.distortion));
  for (const char* name : {"PINHOLE", "OPENCV", "FULL_OPENCV"}) {
    if (4 + shortened.distortion.size() <= FindCameraModel(name)->NumParams()) {
      SetModel(name, shortened, where, camera);
      return;
    }
  }
  throw InputError(where +
                   ": distortion coefficients beyond k1 k2 p1 p2 k3 k4 "
                   "k5 k6 are not supported and must be 0.");
}

LensFitter::LensFitter(const std::string& format,
                       size_t max_num_brown,
                       bool has_fisheye,
                       bool has_fov)
    : format_(format),
      max_num_brown_(max_num_brown),
      has_fisheye_(has_fisheye),
      has_fov_(has_fov) {}

Lens LensFitter::Fit(const KnownCamera& camera) {
  Lens lens = LensOf(camera);
  const bool fits = (lens.kind == Lens::Kind::kBrown &&
                     NumUsed(lens.distortion) <= max_num_brown_) ||
                    (lens.kind == Lens::Kind::kFisheye && has_fisheye_) ||
                    (lens.kind == Lens::Kind::kFov && has_fov_);
  if (fits) return lens;
  if (num_fitted_ + num_left_out_ == 0) first_ = camera.name;
  const CameraModel* opencv = FindCameraModel("OPENCV");
  if (max_num_brown_ < 4 || camera.width == 0) {
    ++num_left_out_;
    lens.kind = Lens::Kind::kBrown;
    lens.distortion.assign(kNumBrown, 0.0);
    return lens;
  }
  KnownCamera fitted = camera;
  fitted.model = opencv;
  fitted.params = ConvertCameraParams(
      *camera.model, camera.params, camera.width, camera.height, *opencv);
  ++num_fitted_;
  max_error_ = std::max(max_error_, MaxDifference(camera, fitted));
  return LensOf(fitted);
}

void LensFitter::AddRemarks(RigRemarks* remarks) const {
  const std::string of = " (the first: '" + first_ + "')";
  if (num_fitted_ > 0) {
    remarks->push_back(
        format_ + " cannot hold the distortion of " +
        std::to_string(num_fitted_) + " cameras" + of +
        host::StringPrintf(": the closest OPENCV lens is written, which is up "
                           "to %.3g px off",
                           max_error_));
  }
  if (num_left_out_ > 0) {
    remarks->push_back(format_ + " cannot hold the distortion of " +
                       std::to_string(num_left_out_) + " cameras" + of +
                       ": it is left out (fit for undistorted images only)");
  }
}

void RequireIntrinsics(const std::string& format, const KnownCamera& camera) {
  if (camera.model != nullptr) return;
  throw InputError("Camera '" + camera.name +
                   "' has no intrinsics, which the format " + format +
                   " needs. Write rig_config, or give a rig that has them.");
}

void RequireImageSize(const std::string& format, const KnownCamera& camera) {
  if (camera.width > 0 && camera.height > 0) return;
  throw InputError("Camera '" + camera.name +
                   "' has no image size, which the format " + format +
                   " needs. Give --image_path with its images, or a rig that "
                   "has image sizes.");
}

std::string WrittenName(const KnownCamera& camera) {
  for (const std::string& name :
       {camera.image_name, FileStem(camera.image_name)}) {
    if (CanonicalCameraName(name) == camera.name) return name;
  }
  return camera.name;
}

std::string WrittenImageName(const KnownCamera& camera) {
  // Without an extension, a dot in the camera's name would be taken for one.
  return std::filesystem::path(camera.image_name).has_extension() &&
                 camera.image_name != camera.name
             ? camera.image_name
             : WrittenName(camera) + ".png";
}

void WriteRigFile(const std::string& path, const std::string& text) {
  std::ofstream file(path, std::ios::trunc | std::ios::binary);
  file << text;
  file.close();
  if (!file) {
    throw OutputError(path +
                      ": cannot write the file. Does its folder exist, "
                      "is it writable, and is the disk not full?");
  }
}

std::string ExactNumber(double value) {
  char text[32];
  const auto end = std::to_chars(
      std::begin(text), std::end(text), value, std::chars_format::general, 17);
  return {text, end.ptr};
}

}  // namespace mfir
