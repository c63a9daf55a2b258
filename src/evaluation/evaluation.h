// Errors of estimated intrinsics against a ground truth: the metrics of the
// paper (You et al., "Multi-Cali Anything", section "Metrics") and what they
// leave open: errors per axis, and the part that all cameras share.

#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <iosfwd>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <vector>

#include "src/sensor/camera_model.h"

namespace mfir {

// The lens of one physical camera.
struct CameraIntrinsics {
  std::string name;
  const CameraModel* model = nullptr;
  size_t width = 0;  // pixels; 0: unknown (ground truth only)
  size_t height = 0;
  std::vector<double> params;  // in the order of `model`
};

// Intrinsics estimated from one frame, or from all of them together.
struct FrameIntrinsics {
  std::string frame_name;  // for messages; empty for a multi-frame result
  std::vector<CameraIntrinsics> cameras;
};

// A metric over frames. A single estimate has a mean only.
struct FrameStatistic {
  double mean = 0;
  std::optional<double> max;
  std::optional<double> min;
};

// Absolute errors over all cameras of all frames. Percentiles interpolate
// linearly between the sorted values.
struct ErrorSpread {
  double median = 0;
  double p95 = 0;
  double max = 0;
};

struct CameraError {
  std::string name;
  std::string model;
  size_t width = 0;
  size_t height = 0;
  // Estimate - truth of fx, fy, cx, cy: pixels, and permille of the true focal
  // length (fx, fy), the image width (cx) and height (cy).
  Eigen::Vector4d error_px = Eigen::Vector4d::Zero();
  Eigen::Vector4d error_permille = Eigen::Vector4d::Zero();
  // RMS of |Project_estimate(Unproject_truth(p)) - p| over the centres p of
  // 16 x 12 equal image cells: what the whole lens model, distortion included,
  // is off in pixels for the same camera pose. Points where the true model
  // cannot be inverted (farther than 0.01 px from p after both ways) are left
  // out. Null if none is left, or the estimate is not finite at one of them.
  std::optional<double> projection_rms_px;
};

// One estimate. Absolute errors are sums of both axes in pixels, relative ones
// in permille, each the mean over cameras.
struct FrameEvaluation {
  std::string frame_name;
  std::vector<CameraError> cameras;  // by name, see CameraNameLess
  double focal_abs = 0;
  double focal_rel = 0;
  double pp_abs = 0;
  double pp_rel = 0;
  // Common to all cameras: mean relative focal length error over cameras and
  // axes (permille), mean principal point error over cameras (pixels).
  double focal_scale = 0;
  Eigen::Vector2d pp_shift = Eigen::Vector2d::Zero();
  // focal_rel and pp_abs after the common part is subtracted.
  double rest_focal_rel = 0;
  double rest_pp_abs = 0;
};

struct Evaluation {
  FrameStatistic focal_abs;
  FrameStatistic focal_rel;
  FrameStatistic pp_abs;
  FrameStatistic pp_rel;
  FrameStatistic focal_scale;
  FrameStatistic pp_shift_x;
  FrameStatistic pp_shift_y;
  FrameStatistic rest_focal_rel;
  FrameStatistic rest_pp_abs;

  std::array<ErrorSpread, 4> spread_px;        // fx, fy, cx, cy
  std::array<ErrorSpread, 2> spread_permille;  // fx, fy
  // Mean and maximum of CameraError::projection_rms_px, where there is one.
  std::optional<double> projection_rms_mean_px;
  std::optional<double> projection_rms_max_px;

  size_t num_cameras = 0;  // of the truth, evaluated in at least one frame
  std::vector<std::string> missing_cameras;  // of the truth, in no estimate
  std::vector<std::string> extra_cameras;    // estimated, not in the truth
  std::vector<std::string> skipped_frames;   // no camera of the truth
  std::vector<FrameEvaluation> frames;
};

// Compares estimates with the ground truth, camera by camera (canonical names).
// One estimate: a multi-frame result without maximum and minimum over frames.
// A camera may appear several times in an estimate with equal intrinsics. The
// image size of the truth may be 0 (KRT has none): the estimate's is used.
//
// Throws InputError for: no camera in common, different intrinsics of one
// camera in one estimate, different image sizes, and missing or non-finite
// parameters or a focal length <= 0 of a compared camera.
Evaluation EvaluateIntrinsics(const std::vector<FrameIntrinsics>& estimates,
                              const std::vector<CameraIntrinsics>& truth);

// The "evaluation" of summary.json and the file of the evaluator. "cameras"
// lists the errors of a single estimate, "frames" the metrics per frame of
// several; the other one is empty. Numbers that are not finite become null.
nlohmann::ordered_json EvaluationToJson(const Evaluation& evaluation);

// A table for people.
void PrintEvaluation(const Evaluation& evaluation, std::ostream& stream);

}  // namespace mfir
