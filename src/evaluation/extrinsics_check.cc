#include "src/evaluation/extrinsics_check.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "src/parallel/order_statistics.h"
#include "src/parallel/parallel_for.h"
#include "src/util/median.h"

namespace mfir {
namespace {

constexpr double kMaxStdRatio = 3.0;
constexpr double kMinStdPx = 0.5;
constexpr double kMaxFocalLengthRatio = 2.0;

// Whether residuals are worse than the keypoints explain; false for NaN.
bool IsBad(double std_px, double own_std_px) {
  return std_px > std::max(kMinStdPx, kMaxStdRatio * own_std_px);
}

bool FocalLengthHasRunAway(const RigCamera& camera,
                           const std::vector<double>& initial_params) {
  const std::vector<size_t>& idxs = camera.model->FocalLengthIdxs();
  return std::any_of(idxs.begin(), idxs.end(), [&](size_t idx) {
    const double ratio = camera.params[idx] / initial_params[idx];
    return !(ratio <= kMaxFocalLengthRatio &&
             ratio >= 1.0 / kMaxFocalLengthRatio);
  });
}

// Of the cameras with observations.
double MedianOfValid(const std::vector<double>& values) {
  std::vector<double> valid;
  for (const double value : values) {
    if (!std::isnan(value)) valid.push_back(value);
  }
  return UpperMedian(valid);
}

}  // namespace

std::vector<double> RobustStdByCamera(
    const Scene& scene, const std::vector<double>& squared_residuals) {
  std::vector<std::vector<double>> by_camera(scene.cameras.size());
  size_t k = 0;
  for (const Frame& frame : scene.frames) {
    for (const Observation& observation : frame.observations) {
      by_camera[frame.images[observation.image_idx].camera_idx].push_back(
          squared_residuals[k++]);
    }
  }
  std::vector<double> stds_px;
  for (const std::vector<double>& squared : by_camera) {
    stds_px.push_back(
        std::sqrt(UpperMedian(squared, *scene.ranks) / (2.0 * std::log(2.0))));
  }
  return stds_px;
}

std::vector<double> OwnSquaredResiduals(const Scene& scene,
                                        const Estimate& estimate,
                                        int num_threads) {
  std::vector<size_t> begins = {0};
  for (const Frame& frame : scene.frames) {
    begins.push_back(begins.back() + frame.observations.size());
  }
  std::vector<double> squared_residuals(begins.back());
  ParallelFor(scene.frames.size(), num_threads, [&](size_t f) {
    const Frame& frame = scene.frames[f];
    const FrameEstimate& own = estimate.frames[f];
    for (size_t i = 0; i < frame.NumPoints(); ++i) {
      for (size_t k = frame.track_begins[i]; k < frame.track_begins[i + 1];
           ++k) {
        const Observation& observation = frame.observations[k];
        const ImageEstimate& image = own.images[observation.image_idx];
        const size_t camera_idx =
            frame.images[observation.image_idx].camera_idx;
        const Eigen::Vector3d p = image.cam_from_world * own.points[i];
        Eigen::Vector2d xy;
        scene.cameras[camera_idx].model->Project(
            image.params.data(), p.x() / p.z(), p.y() / p.z(), xy.data());
        const double squared = (xy - observation.xy).squaredNorm();
        squared_residuals[begins[f] + k] =
            p.z() > 0.0 && std::isfinite(squared)
                ? squared
                : std::numeric_limits<double>::infinity();
      }
    }
  });
  return squared_residuals;
}

std::vector<ExtrinsicsContradiction> FindExtrinsicsContradictions(
    const std::vector<double>& start_stds_px,
    const std::vector<double>& stds_px,
    const std::vector<double>& own_stds_px) {
  const double others_std_px = MedianOfValid(stds_px);
  const bool all_spoilt = IsBad(others_std_px, MedianOfValid(own_stds_px));
  const std::vector<double>& compared = all_spoilt ? start_stds_px : stds_px;
  const double median = MedianOfValid(compared);
  std::vector<ExtrinsicsContradiction> contradictions;
  for (size_t i = 0; i < stds_px.size(); ++i) {
    if (compared[i] > kMaxStdRatio * median &&
        IsBad(stds_px[i], own_stds_px[i])) {
      contradictions.push_back({i, stds_px[i], others_std_px, own_stds_px[i]});
    }
  }
  return contradictions;
}

SpoiltCameras CountSpoiltCameras(
    const Scene& scene,
    const Estimate& estimate,
    const std::vector<ExtrinsicsContradiction>& contradictions,
    const std::vector<double>& stds_px,
    const std::vector<double>& own_stds_px) {
  SpoiltCameras count;
  for (size_t i = 0; i < scene.cameras.size(); ++i) {
    const bool contradicts =
        std::any_of(contradictions.begin(),
                    contradictions.end(),
                    [i](const ExtrinsicsContradiction& contradiction) {
                      return contradiction.camera_idx == i;
                    });
    if (contradicts || std::isnan(stds_px[i])) continue;
    ++count.num_others;
    count.num_spoilt +=
        IsBad(stds_px[i], own_stds_px[i]) ||
        FocalLengthHasRunAway(estimate.cameras[i], scene.cameras[i].params);
  }
  return count;
}

}  // namespace mfir
