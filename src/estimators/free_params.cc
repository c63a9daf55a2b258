#include "src/estimators/free_params.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <Eigen/Geometry>

namespace mfir {
namespace {

// How far from its start a parameter may well be: a focal length by this share
// of it, the others by what moves the image corner by this share of half the
// image diagonal.
constexpr double kPlausibleShare = 0.02;
// The weak prior of distortion is this much wider.
constexpr double kWeakPriorFactor = 2.5;
// Corrections of poses have a prior of their own, and are never held.
constexpr double kPosePlausibleFactor = 10.0;

// How far the image corner moves (px) with the parameter; infinite for NaN.
double CornerShift(const RigCamera& camera, size_t idx, double change) {
  const CameraModel& model = *camera.model;
  std::vector<double> params = camera.params;
  Eigen::Vector2d uv;
  Eigen::Vector2d before;
  model.Unproject(params.data(),
                  static_cast<double>(camera.width),
                  static_cast<double>(camera.height),
                  uv.data());
  model.Project(params.data(), uv.x(), uv.y(), before.data());
  double max_shift = 0.0;
  for (const double sign : {-1.0, 1.0}) {
    params[idx] = camera.params[idx] + sign * change;
    Eigen::Vector2d after;
    model.Project(params.data(), uv.x(), uv.y(), after.data());
    const double shift = (after - before).norm();
    max_shift = std::isfinite(shift) ? std::max(max_shift, shift)
                                     : std::numeric_limits<double>::infinity();
  }
  return max_shift;
}

// The change of a distortion coefficient that moves the image corner by `shift`
// (px). The derivative alone would not do: that of the angle of FOV is 0 where
// the angle is.
double ChangeOfCornerShift(const RigCamera& camera,
                           const FreeParam& param,
                           double shift) {
  double low = 0.0;
  double high = shift / param.pixels;
  if (CornerShift(camera, param.idx, high) <= 2.0 * shift) return high;
  for (int i = 0; i < 30; ++i) {
    const double middle = 0.5 * (low + high);
    (CornerShift(camera, param.idx, middle) < shift ? low : high) = middle;
  }
  return high;
}

double PlausibleStd(const FixedExtrinsicsOptions& options,
                    const RigCamera& known_camera,
                    const RigCamera& camera,
                    const FreeParam& param) {
  if (options.min_information > 0.0) {
    return 1.0 / (std::sqrt(options.min_information) * param.pixels);
  }
  if (param.type == FreeParam::kFocalLength) {
    return kPlausibleShare * known_camera.params[param.idx];
  }
  const double shift =
      kPlausibleShare * 0.5 * std::hypot(camera.width, camera.height);
  return param.type == FreeParam::kPrincipalPoint
             ? shift
             : ChangeOfCornerShift(camera, param, shift);
}

Eigen::Matrix3d ExpRotation(const Eigen::Vector3d& rotation_vector) {
  const double angle = rotation_vector.norm();
  if (angle == 0.0) return Eigen::Matrix3d::Identity();
  return Eigen::AngleAxisd(angle, rotation_vector / angle).toRotationMatrix();
}

Eigen::Vector3d LogRotation(const Eigen::Matrix3d& rotation) {
  const Eigen::AngleAxisd angle_axis(rotation);
  return angle_axis.angle() * angle_axis.axis();
}

// Applies a rotation vector (rad) after the present rotation and shifts the
// camera centre.
void MovePose(const Eigen::Vector3d& rotation,
              const Eigen::Vector3d& center_shift,
              CameraState* state) {
  const Eigen::Vector3d center =
      -state->rotation.transpose() * state->translation + center_shift;
  state->rotation = ExpRotation(rotation) * state->rotation;
  state->translation = -state->rotation * center;
}

// In the order of FreeParams.
std::vector<FreeParam> FreeParamsOfCamera(const FixedExtrinsicsOptions& options,
                                          const Scene& scene,
                                          const Estimate& estimate,
                                          size_t camera_idx) {
  const RigCamera& known_camera = scene.cameras[camera_idx];
  const RigCamera& camera = estimate.cameras[camera_idx];
  const CameraModel& model = *camera.model;
  const std::vector<double> pixel_scales = PixelScales(camera);
  const double focal_length = camera.params[model.FocalLengthIdxs()[0]];
  const auto contains = [](const std::vector<size_t>& idxs, size_t idx) {
    return std::find(idxs.begin(), idxs.end(), idx) != idxs.end();
  };
  const bool constant =
      !options.constant_cameras.empty() && options.constant_cameras[camera_idx];
  std::vector<FreeParam> params;
  for (size_t idx = 0; idx < model.NumParams() && !constant; ++idx) {
    FreeParam param = {FreeParam::kExtra,
                       camera_idx,
                       idx,
                       pixel_scales[idx],
                       focal_length,
                       0.0,
                       0.0};
    bool refine = options.refine_extra_params;
    if (contains(model.FocalLengthIdxs(), idx)) {
      param.type = FreeParam::kFocalLength;
      param.prior_std = options.focal_std;
      refine = options.refine_focal_length;
    } else if (contains(model.PrincipalPointIdxs(), idx)) {
      param.type = FreeParam::kPrincipalPoint;
      param.prior_std = options.principal_point_std;
      refine = options.refine_principal_point;
    }
    if (!refine) continue;
    param.plausible_std = PlausibleStd(options, known_camera, camera, param);
    if (options.weak_distortion_prior && param.type == FreeParam::kExtra) {
      param.prior_std = kWeakPriorFactor * param.plausible_std;
    }
    params.push_back(param);
  }
  if (options.rotation_std == 0.0 && options.center_std == 0.0) return params;
  // A standard deviation of zero means exactly known: a very stiff prior.
  const double distance =
      std::max(known_camera.cam_from_world.Center().norm(), 1e-300);
  const double rotation_std =
      options.rotation_std > 0.0 ? options.rotation_std : 1e-12;
  const double center_std =
      options.center_std > 0.0 ? options.center_std : 1e-12 * distance;
  for (size_t axis = 0; axis < 3; ++axis) {
    params.push_back({FreeParam::kRotation,
                      camera_idx,
                      axis,
                      focal_length,
                      focal_length,
                      rotation_std,
                      kPosePlausibleFactor * rotation_std});
  }
  for (size_t axis = 0; axis < 3; ++axis) {
    params.push_back({FreeParam::kCenter,
                      camera_idx,
                      axis,
                      focal_length / distance,
                      focal_length,
                      center_std,
                      kPosePlausibleFactor * center_std});
  }
  return params;
}

FreeParams ToFreeParams(const std::vector<FreeParam>& camera_params) {
  FreeParams free_params;
  for (const FreeParam& param : camera_params) {
    if (param.IsPose()) {
      free_params.pose = true;
    } else {
      free_params.intrinsics_idxs.push_back(param.idx);
    }
  }
  return free_params;
}

}  // namespace

std::vector<double> PixelScales(const RigCamera& camera) {
  const size_t num_params = camera.model->NumParams();
  double uv[2];
  double xy[2];
  double jacobian_uv[4];
  std::vector<double> jacobian(2 * num_params);
  camera.model->Unproject(camera.params.data(),
                          static_cast<double>(camera.width),
                          static_cast<double>(camera.height),
                          uv);
  camera.model->ProjectWithJacobian(
      camera.params.data(), uv[0], uv[1], xy, jacobian_uv, jacobian.data());
  std::vector<double> scales(num_params, 1.0);
  for (const size_t idx : camera.model->ExtraParamsIdxs()) {
    const double scale = std::hypot(jacobian[idx], jacobian[num_params + idx]);
    if (std::isfinite(scale) && scale > 0.0) scales[idx] = scale;
  }
  return scales;
}

ReducedParams CollectFreeParams(const FixedExtrinsicsOptions& options,
                                const Scene& scene,
                                const Estimate& estimate,
                                const std::vector<bool>& observed) {
  ReducedParams reduced;
  for (size_t i = 0; i < scene.cameras.size(); ++i) {
    reduced.offsets.push_back(reduced.Size());
    const std::vector<FreeParam> camera_params =
        observed[i] ? FreeParamsOfCamera(options, scene, estimate, i)
                    : std::vector<FreeParam>();
    reduced.by_camera.push_back(ToFreeParams(camera_params));
    reduced.params.insert(
        reduced.params.end(), camera_params.begin(), camera_params.end());
  }
  return reduced;
}

Eigen::VectorXd PriorResiduals(const std::vector<FreeParam>& params,
                               const Scene& scene,
                               const std::vector<CameraState>& states) {
  const Eigen::Index num_params = static_cast<Eigen::Index>(params.size());
  Eigen::VectorXd residuals = Eigen::VectorXd::Zero(num_params);
  for (Eigen::Index i = 0; i < num_params; ++i) {
    const FreeParam& param = params[i];
    if (param.prior_std == 0.0) continue;
    const RigCamera& known_camera = scene.cameras[param.camera_idx];
    const CameraState& state = states[param.camera_idx];
    double difference = 0.0;
    if (param.type == FreeParam::kRotation) {
      const Eigen::Matrix3d known =
          known_camera.cam_from_world.rotation.toRotationMatrix();
      difference = LogRotation(state.rotation * known.transpose())(param.idx);
    } else if (param.type == FreeParam::kCenter) {
      const Eigen::Vector3d center =
          -state.rotation.transpose() * state.translation;
      difference = (center - known_camera.cam_from_world.Center())(param.idx);
    } else {
      difference = state.params[param.idx] - known_camera.params[param.idx];
    }
    residuals(i) = difference / param.prior_std;
  }
  return residuals;
}

std::vector<CameraState> AddStep(const ReducedParams& params,
                                 const Eigen::VectorXd& step,
                                 std::vector<CameraState> states) {
  for (size_t i = 0; i < states.size(); ++i) {
    CameraState& state = states[i];
    Eigen::Index k = params.offsets[i];
    for (const size_t idx : params.by_camera[i].intrinsics_idxs) {
      state.params[idx] += step(k++);
    }
    if (params.by_camera[i].pose) {
      MovePose(step.segment<3>(k), step.segment<3>(k + 3), &state);
    }
  }
  return states;
}

}  // namespace mfir
