#include "src/evaluation/evaluation.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "src/sensor/camera_naming.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

using CamerasByName =
    std::map<std::string, const CameraIntrinsics*, decltype(&CameraNameLess)>;
using Names = std::set<std::string, decltype(&CameraNameLess)>;

// "Camera 'cam07' of frame '000015'", for messages.
std::string CameraInFrame(const std::string& camera_name,
                          const std::string& frame_name) {
  return "Camera '" + camera_name + "'" +
         (frame_name.empty() ? "" : " of frame '" + frame_name + "'");
}

std::string ImageSize(const CameraIntrinsics& camera) {
  return std::to_string(camera.width) + " x " + std::to_string(camera.height);
}

CamerasByName IndexByName(const std::vector<CameraIntrinsics>& cameras,
                          const std::string& frame_name) {
  CamerasByName by_name(&CameraNameLess);
  for (const CameraIntrinsics& camera : cameras) {
    const auto [it, inserted] = by_name.emplace(camera.name, &camera);
    const CameraIntrinsics& first = *it->second;
    if (!inserted &&
        (first.model != camera.model || first.width != camera.width ||
         first.height != camera.height || first.params != camera.params)) {
      throw InputError(
          CameraInFrame(camera.name, frame_name) +
          " has several different sets of intrinsics. Give one model per frame "
          "if the images are of different frames, or set "
          "--MultiFrame.camera_name_regex if they are of different cameras.");
    }
  }
  return by_name;
}

// fx, fy, cx, cy.
Eigen::Vector4d FocalLengthsAndPrincipalPoint(const CameraIntrinsics& camera) {
  const std::vector<size_t>& focal_idxs = camera.model->FocalLengthIdxs();
  const std::vector<size_t>& pp_idxs = camera.model->PrincipalPointIdxs();
  return {camera.params[focal_idxs.front()],
          camera.params[focal_idxs.back()],
          camera.params[pp_idxs[0]],
          camera.params[pp_idxs[1]]};
}

// `what`: "Camera 'cam07': the estimate", for messages.
void CheckIntrinsics(const CameraIntrinsics& camera, const std::string& what) {
  if (camera.model == nullptr) {
    throw InputError(what + " has no intrinsics. Leave the camera out.");
  }
  if (camera.params.size() != camera.model->NumParams()) {
    throw InputError(what + " has " + std::to_string(camera.params.size()) +
                     " parameters, the camera model " + camera.model->Name() +
                     " needs " + std::to_string(camera.model->NumParams()) +
                     ".");
  }
  if (!std::all_of(camera.params.begin(), camera.params.end(), [](double x) {
        return std::isfinite(x);
      })) {
    throw InputError(what + " has a parameter that is not a finite number.");
  }
  const Eigen::Vector4d focal_and_pp = FocalLengthsAndPrincipalPoint(camera);
  if (focal_and_pp.head<2>().minCoeff() <= 0) {
    throw InputError(what + " has a focal length that is not positive.");
  }
}

std::optional<double> ProjectionRms(const CameraIntrinsics& estimate,
                                    const CameraIntrinsics& truth,
                                    const Eigen::Vector2d& image_size) {
  constexpr int kNumCols = 16;
  constexpr int kNumRows = 12;
  constexpr double kMaxInversionErrorPx = 0.01;
  double sum_squares = 0;
  int num_points = 0;
  for (int row = 0; row < kNumRows; ++row) {
    for (int col = 0; col < kNumCols; ++col) {
      const Eigen::Vector2d xy((col + 0.5) / kNumCols * image_size.x(),
                               (row + 0.5) / kNumRows * image_size.y());
      Eigen::Vector2d uv, xy_truth, xy_estimate;
      truth.model->Unproject(truth.params.data(), xy.x(), xy.y(), uv.data());
      truth.model->Project(
          truth.params.data(), uv.x(), uv.y(), xy_truth.data());
      // Negated: true for NaN as well.
      if (!((xy_truth - xy).norm() < kMaxInversionErrorPx)) {
        continue;
      }
      estimate.model->Project(
          estimate.params.data(), uv.x(), uv.y(), xy_estimate.data());
      sum_squares += (xy_estimate - xy).squaredNorm();
      ++num_points;
    }
  }
  if (num_points == 0 || !std::isfinite(sum_squares)) {
    return std::nullopt;
  }
  return std::sqrt(sum_squares / num_points);
}

CameraError EvaluateCamera(const CameraIntrinsics& estimate,
                           const CameraIntrinsics& truth,
                           const std::string& frame_name) {
  const std::string camera = CameraInFrame(estimate.name, frame_name) + ": ";
  CheckIntrinsics(estimate, camera + "the estimate");
  CheckIntrinsics(truth, camera + "the ground truth");
  if (estimate.width == 0 || estimate.height == 0) {
    throw InputError(camera + "the estimate has no image size.");
  }
  // KRT files, for instance, have no image size.
  const bool truth_has_size = truth.width != 0 || truth.height != 0;
  if (truth_has_size &&
      (truth.width != estimate.width || truth.height != estimate.height)) {
    throw InputError(camera + "the image size of the estimate is " +
                     ImageSize(estimate) + ", that of the ground truth " +
                     ImageSize(truth) +
                     ". Give the ground truth of images of the same size.");
  }

  CameraError error;
  error.name = estimate.name;
  error.model = estimate.model->Name();
  error.width = estimate.width;
  error.height = estimate.height;
  const Eigen::Vector2d image_size(estimate.width, estimate.height);
  const Eigen::Vector4d expected = FocalLengthsAndPrincipalPoint(truth);
  error.error_px = FocalLengthsAndPrincipalPoint(estimate) - expected;
  error.error_permille.head<2>() =
      1e3 * error.error_px.head<2>().cwiseQuotient(expected.head<2>());
  error.error_permille.tail<2>() =
      1e3 * error.error_px.tail<2>().cwiseQuotient(image_size);
  error.projection_rms_px = ProjectionRms(estimate, truth, image_size);
  return error;
}

// Sets the metrics of a frame from its cameras (at least one).
void SetFrameMetrics(FrameEvaluation* frame) {
  const double num_cameras = frame->cameras.size();
  for (const CameraError& camera : frame->cameras) {
    const auto& px = camera.error_px;
    const auto& permille = camera.error_permille;
    frame->focal_abs += px.head<2>().lpNorm<1>() / num_cameras;
    frame->focal_rel += permille.head<2>().lpNorm<1>() / num_cameras;
    frame->pp_abs += px.tail<2>().lpNorm<1>() / num_cameras;
    frame->pp_rel += permille.tail<2>().lpNorm<1>() / num_cameras;
    frame->focal_scale += permille.head<2>().mean() / num_cameras;
    frame->pp_shift += px.tail<2>() / num_cameras;
  }
  for (const CameraError& camera : frame->cameras) {
    const Eigen::Array2d focal =
        camera.error_permille.head<2>().array() - frame->focal_scale;
    const Eigen::Vector2d pp = camera.error_px.tail<2>() - frame->pp_shift;
    frame->rest_focal_rel += focal.abs().sum() / num_cameras;
    frame->rest_pp_abs += pp.lpNorm<1>() / num_cameras;
  }
}

template <typename Metric>
FrameStatistic OverFrames(const std::vector<FrameEvaluation>& frames,
                          const Metric& metric) {
  std::vector<double> values;
  double sum = 0;
  for (const FrameEvaluation& frame : frames) {
    values.push_back(metric(frame));
    sum += values.back();
  }
  FrameStatistic statistic;
  statistic.mean = sum / values.size();
  if (values.size() > 1) {
    statistic.max = *std::max_element(values.begin(), values.end());
    statistic.min = *std::min_element(values.begin(), values.end());
    // Rounding of the sum must not carry the mean outside.
    statistic.mean = std::clamp(statistic.mean, *statistic.min, *statistic.max);
  }
  return statistic;
}

template <typename CameraValue>
ErrorSpread SpreadOverCameras(const std::vector<FrameEvaluation>& frames,
                              const CameraValue& value) {
  std::vector<double> values;
  for (const FrameEvaluation& frame : frames) {
    for (const CameraError& camera : frame.cameras) {
      values.push_back(std::abs(value(camera)));
    }
  }
  std::sort(values.begin(), values.end());
  const auto percentile = [&values](double fraction) {
    const double position = fraction * (values.size() - 1);
    const size_t below = static_cast<size_t>(position);
    const size_t above = std::min(below + 1, values.size() - 1);
    return values[below] + (position - below) * (values[above] - values[below]);
  };
  return {percentile(0.5), percentile(0.95), values.back()};
}

void SetProjectionRms(Evaluation* evaluation) {
  double sum = 0;
  double max = 0;
  size_t num_values = 0;
  for (const FrameEvaluation& frame : evaluation->frames) {
    for (const CameraError& camera : frame.cameras) {
      if (camera.projection_rms_px) {
        sum += *camera.projection_rms_px;
        max = std::max(max, *camera.projection_rms_px);
        ++num_values;
      }
    }
  }
  if (num_values > 0) {
    evaluation->projection_rms_mean_px = sum / num_values;
    evaluation->projection_rms_max_px = max;
  }
}

// Sets everything that follows from `evaluation->frames` (at least one).
void SetStatistics(Evaluation* evaluation) {
  const std::vector<FrameEvaluation>& frames = evaluation->frames;
  const auto over_frames = [&frames](double FrameEvaluation::*metric) {
    return OverFrames(frames, [metric](const FrameEvaluation& frame) {
      return frame.*metric;
    });
  };
  evaluation->focal_abs = over_frames(&FrameEvaluation::focal_abs);
  evaluation->focal_rel = over_frames(&FrameEvaluation::focal_rel);
  evaluation->pp_abs = over_frames(&FrameEvaluation::pp_abs);
  evaluation->pp_rel = over_frames(&FrameEvaluation::pp_rel);
  evaluation->focal_scale = over_frames(&FrameEvaluation::focal_scale);
  evaluation->pp_shift_x =
      OverFrames(frames, [](const auto& frame) { return frame.pp_shift.x(); });
  evaluation->pp_shift_y =
      OverFrames(frames, [](const auto& frame) { return frame.pp_shift.y(); });
  evaluation->rest_focal_rel = over_frames(&FrameEvaluation::rest_focal_rel);
  evaluation->rest_pp_abs = over_frames(&FrameEvaluation::rest_pp_abs);

  for (size_t axis = 0; axis < evaluation->spread_px.size(); ++axis) {
    evaluation->spread_px[axis] = SpreadOverCameras(
        frames,
        [axis](const CameraError& camera) { return camera.error_px(axis); });
  }
  for (size_t axis = 0; axis < evaluation->spread_permille.size(); ++axis) {
    evaluation->spread_permille[axis] =
        SpreadOverCameras(frames, [axis](const CameraError& camera) {
          return camera.error_permille(axis);
        });
  }
  SetProjectionRms(evaluation);
}

// A few names of each side, so that the reader sees how they differ.
std::string FirstNames(const CamerasByName& cameras) {
  constexpr size_t kMaxNames = 3;
  std::string text;
  size_t num_names = 0;
  for (const auto& [name, camera] : cameras) {
    if (num_names++ == kMaxNames) return text + ", ...";
    text += (text.empty() ? "'" : ", '") + name + "'";
  }
  return text.empty() ? "none" : text;
}

}  // namespace

Evaluation EvaluateIntrinsics(const std::vector<FrameIntrinsics>& estimates,
                              const std::vector<CameraIntrinsics>& truth) {
  const CamerasByName truth_by_name = IndexByName(truth, "");
  CamerasByName all_estimated(&CameraNameLess);
  Names evaluated(&CameraNameLess);
  Names extra(&CameraNameLess);
  Evaluation evaluation;
  for (const FrameIntrinsics& estimate : estimates) {
    const CamerasByName estimated =
        IndexByName(estimate.cameras, estimate.frame_name);
    all_estimated.insert(estimated.begin(), estimated.end());
    FrameEvaluation frame;
    frame.frame_name = estimate.frame_name;
    for (const auto& [name, camera] : estimated) {
      const auto it = truth_by_name.find(name);
      if (it == truth_by_name.end()) {
        extra.insert(name);
        continue;
      }
      evaluated.insert(name);
      frame.cameras.push_back(
          EvaluateCamera(*camera, *it->second, estimate.frame_name));
    }
    if (frame.cameras.empty()) {
      evaluation.skipped_frames.push_back(estimate.frame_name);
      continue;
    }
    SetFrameMetrics(&frame);
    evaluation.frames.push_back(std::move(frame));
  }
  if (evaluation.frames.empty()) {
    throw InputError(
        "The estimate and the ground truth have no camera in common. Cameras "
        "of the estimate: " +
        FirstNames(all_estimated) +
        "; of the ground truth: " + FirstNames(truth_by_name) +
        ". Set --MultiFrame.camera_name_regex so that both give the same "
        "names.");
  }

  evaluation.num_cameras = evaluated.size();
  evaluation.extra_cameras.assign(extra.begin(), extra.end());
  for (const auto& [name, camera] : truth_by_name) {
    if (evaluated.count(name) == 0) {
      evaluation.missing_cameras.push_back(name);
    }
  }
  SetStatistics(&evaluation);
  return evaluation;
}

}  // namespace mfir
