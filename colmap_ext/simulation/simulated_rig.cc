#include "colmap_ext/simulation/simulated_rig.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "colmap_ext/models/camera_models.h"

namespace mfir {
namespace {

double Radians(double degrees) { return degrees * M_PI / 180.0; }

Eigen::Vector3d NormalVector(double sigma, Random* random) {
  // Braces: the order of evaluation is that of the text.
  return Eigen::Vector3d{random->Normal(0.0, sigma),
                         random->Normal(0.0, sigma),
                         random->Normal(0.0, sigma)};
}

Eigen::Quaterniond Rotation(const Eigen::Vector3d& angle_axis_rad) {
  const double angle = angle_axis_rad.norm();
  return angle == 0.0 ? Eigen::Quaterniond::Identity()
                      : Eigen::Quaterniond(
                            Eigen::AngleAxisd(angle, angle_axis_rad / angle));
}

double HalfDiagonal(const RigCamera& camera) {
  return 0.5 * std::hypot(camera.width, camera.height);
}

// A pose on a Fibonacci lattice of the dome with some play in position, aim and
// roll.
Rigid3 DomePose(const SimulatorOptions& options,
                int camera_idx,
                Random* random) {
  const double golden_ratio = 0.5 * (std::sqrt(5.0) - 1.0);
  const double sin_min = std::sin(Radians(options.min_elevation));
  const double sin_max = std::sin(Radians(options.max_elevation));
  const double share = (camera_idx + 0.5) / options.num_cameras;
  const double turn = std::fmod(camera_idx * golden_ratio, 1.0);
  const double elevation = std::asin(sin_min + (sin_max - sin_min) * share) +
                           random->Normal(0.0, Radians(2.0));
  const double azimuth = Radians(options.azimuth) * (2.0 * turn - 1.0) +
                         random->Normal(0.0, Radians(2.0));
  const double radius = options.distance * (1.0 + random->Normal(0.0, 0.04));
  const Eigen::Vector3d center =
      radius * Eigen::Vector3d(std::cos(elevation) * std::sin(azimuth),
                               -std::sin(elevation),
                               -std::cos(elevation) * std::cos(azimuth));
  const Eigen::Vector3d target = NormalVector(0.008, random);

  const Eigen::Vector3d z_axis = (target - center).normalized();
  const Eigen::Vector3d x_axis =
      Eigen::Vector3d::UnitY().cross(z_axis).normalized();
  Eigen::Matrix3d rotation;
  rotation << x_axis.transpose(), z_axis.cross(x_axis).transpose(),
      z_axis.transpose();
  const double roll = random->Normal(0.0, Radians(2.0));
  Rigid3 cam_from_world;
  cam_from_world.rotation =
      (Rotation({0.0, 0.0, roll}) * Eigen::Quaterniond(rotation)).normalized();
  cam_from_world.translation =
      -(cam_from_world.rotation * center) * UnitsPerMetre(options);
  return cam_from_world;
}

// Change of each extra parameter that moves the image corner by one pixel.
std::vector<double> ExtraParamsPerPixel(const RigCamera& camera) {
  const size_t num_params = camera.model->NumParams();
  Eigen::Vector2d uv, xy;
  camera.model->Unproject(camera.params.data(), 0.0, 0.0, uv.data());
  std::vector<double> jacobian_uv(4), jacobian_params(2 * num_params);
  camera.model->ProjectWithJacobian(camera.params.data(),
                                    uv.x(),
                                    uv.y(),
                                    xy.data(),
                                    jacobian_uv.data(),
                                    jacobian_params.data());
  std::vector<double> params_per_pixel;
  for (const size_t idx : camera.model->ExtraParamsIdxs()) {
    params_per_pixel.push_back(
        1.0 /
        std::hypot(jacobian_params[idx], jacobian_params[num_params + idx]));
  }
  return params_per_pixel;
}

// Each parameter has half the effect of the one before, as in real lenses; all
// together at most 1.
std::vector<double> ExtraParamsShares(size_t num_extra_params) {
  std::vector<double> shares(num_extra_params);
  double sum = 0.0;
  for (size_t i = 0; i < num_extra_params; ++i) {
    shares[i] = std::pow(0.5, static_cast<double>(i));
    sum += shares[i];
  }
  for (double& share : shares) {
    share /= sum;
  }
  return shares;
}

// Distortion of at most options.distortion at the image corner: so small that
// the model is one to one over the whole image.
void DrawDistortion(const SimulatorOptions& options,
                    Random* random,
                    RigCamera* camera) {
  const std::vector<size_t>& idxs = camera->model->ExtraParamsIdxs();
  const double corner_radius =
      HalfDiagonal(*camera) / NominalFocalLength(options);
  // Two models cannot be changed from a state free of distortion.
  if (camera->model->Name() == "FOV") {
    // Its parameter, an angle, acts by its square, about omega^2 r^2 / 3.
    const double omega = std::sqrt(3.0 * options.distortion) / corner_radius;
    camera->params[idxs[0]] =
        std::clamp(omega, 0.3, 1.0) * random->Uniform(0.5, 1.0);
    return;
  }
  if (camera->model->Name() == "EUCM") {
    // Acts by about alpha beta r^2 / 2: beta alone does nothing.
    const double alpha =
        2.0 * options.distortion / (corner_radius * corner_radius);
    camera->params[idxs[0]] =
        std::clamp(alpha, 0.1, 0.8) * random->Uniform(0.5, 1.0);
    camera->params[idxs[1]] = random->Uniform(0.9, 1.1);
    return;
  }
  const std::vector<double> per_pixel = ExtraParamsPerPixel(*camera);
  const std::vector<double> shares = ExtraParamsShares(idxs.size());
  for (size_t i = 0; i < idxs.size(); ++i) {
    camera->params[idxs[i]] = random->Uniform(-1.0, 1.0) * shares[i] *
                              options.distortion * HalfDiagonal(*camera) *
                              per_pixel[i];
  }
}

// Focal lengths with a common relative error, and a small one of their ratio.
void PerturbFocalLength(double sigma,
                        double ratio_sigma,
                        const CameraModel& model,
                        Random* random,
                        std::vector<double>* params) {
  const double common = random->Normal(0.0, sigma);
  const double ratio = random->Normal(0.0, ratio_sigma);
  const std::vector<size_t>& idxs = model.FocalLengthIdxs();
  for (size_t i = 0; i < idxs.size(); ++i) {
    const double sign = idxs.size() == 1 ? 0.0 : (i == 0 ? 1.0 : -1.0);
    (*params)[idxs[i]] *= 1.0 + common + sign * ratio;
  }
}

}  // namespace

double UnitsPerMetre(const SimulatorOptions& options) {
  return options.unit == "mm" ? 1000.0 : 1.0;
}

double NominalFocalLength(const SimulatorOptions& options) {
  if (options.focal_length > 0.0) {
    return options.focal_length;
  }
  // Half the width and height of the head in metres, with some room around.
  constexpr double kHalfWidth = 0.105;
  constexpr double kHalfHeight = 0.125;
  constexpr double kFill = 0.9;
  return kFill * options.distance *
         std::min(0.5 * options.image_width / kHalfWidth,
                  0.5 * options.image_height / kHalfHeight);
}

std::vector<RigCamera> MakeTrueCameras(const SimulatorOptions& options) {
  // As many digits as the last camera needs, at least two.
  const size_t num_digits =
      std::max<size_t>(2, std::to_string(options.num_cameras - 1).size());
  std::vector<RigCamera> cameras;
  for (int i = 0; i < options.num_cameras; ++i) {
    Random random({static_cast<uint64_t>(options.seed),
                   kTrueCameraStream,
                   static_cast<uint64_t>(i)});
    RigCamera camera;
    const std::string number = std::to_string(i);
    camera.name = "cam" + std::string(num_digits - number.size(), '0') + number;
    camera.cam_from_world = DomePose(options, i, &random);
    camera.model = FindCameraModel(options.camera_model);
    camera.width = options.image_width;
    camera.height = options.image_height;
    camera.params.assign(camera.model->NumParams(), 0.0);
    for (const size_t idx : camera.model->FocalLengthIdxs()) {
      camera.params[idx] = NominalFocalLength(options);
    }
    const std::vector<size_t>& center_idxs = camera.model->PrincipalPointIdxs();
    camera.params[center_idxs[0]] = 0.5 * options.image_width;
    camera.params[center_idxs[1]] = 0.5 * options.image_height;
    DrawDistortion(options, &random, &camera);
    PerturbFocalLength(options.focal_length_sigma,
                       0.05 * options.focal_length_sigma,
                       *camera.model,
                       &random,
                       &camera.params);
    for (const size_t idx : center_idxs) {
      camera.params[idx] += random.Normal(0.0, options.principal_point_sigma);
    }
    cameras.push_back(camera);
  }
  return cameras;
}

std::vector<RigCamera> MakeKnownCameras(
    const SimulatorOptions& options,
    const std::vector<RigCamera>& true_cameras) {
  std::vector<RigCamera> cameras = true_cameras;
  for (size_t i = 0; i < cameras.size(); ++i) {
    Random random({static_cast<uint64_t>(options.seed), kKnownCameraStream, i});
    RigCamera& camera = cameras[i];
    camera.params = DriftIntrinsics(options, camera, &random);
    Rigid3& pose = camera.cam_from_world;
    const Eigen::Vector3d angle_axis =
        NormalVector(Radians(options.rig_rotation_sigma), &random);
    const Eigen::Vector3d center_error = NormalVector(
        options.rig_center_sigma / 1000.0 * UnitsPerMetre(options), &random);
    // Left alone without errors: extrinsics stay bit-identical to the true
    // ones.
    if (options.rig_rotation_sigma > 0.0 || options.rig_center_sigma > 0.0) {
      const Eigen::Vector3d center = pose.Center() + center_error;
      pose.rotation = (Rotation(angle_axis) * pose.rotation).normalized();
      pose.translation = -(pose.rotation * center);
    }
  }
  return cameras;
}

std::vector<double> DriftIntrinsics(const SimulatorOptions& options,
                                    const RigCamera& camera,
                                    Random* random) {
  std::vector<double> params = camera.params;
  PerturbFocalLength(options.initial_focal_length_sigma,
                     0.1 * options.initial_focal_length_sigma,
                     *camera.model,
                     random,
                     &params);
  for (const size_t idx : camera.model->PrincipalPointIdxs()) {
    params[idx] += random->Normal(0.0, options.initial_principal_point_sigma);
  }
  const std::vector<size_t>& idxs = camera.model->ExtraParamsIdxs();
  const std::vector<double> per_pixel = ExtraParamsPerPixel(camera);
  const std::vector<double> shares = ExtraParamsShares(idxs.size());
  for (size_t i = 0; i < idxs.size(); ++i) {
    params[idxs[i]] += random->Normal() * shares[i] *
                       options.initial_distortion_sigma * HalfDiagonal(camera) *
                       per_pixel[i];
  }
  return params;
}

}  // namespace mfir
