#include "colmap_ext/options/simulator_options.h"

#include <algorithm>
#include <cmath>
#include <sstream>

#include "colmap_ext/models/camera_models.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

struct Range {
  const char* name;
  double value;
  double min;
  double max;
};

void CheckRange(const Range& range) {
  // Also false for NaN.
  if (range.value >= range.min && range.value <= range.max) {
    return;
  }
  std::ostringstream message;
  message << "--Simulator." << range.name << " must lie between " << range.min
          << " and " << range.max << ", but is " << range.value << ".";
  throw UsageError(message.str());
}

void CheckOrder(const std::string& min_name,
                double min,
                const std::string& max_name,
                double max) {
  if (min > max) {
    throw UsageError("--Simulator." + min_name +
                     " must not be larger than --Simulator." + max_name + ".");
  }
}

}  // namespace

void SimulatorOptions::Check() const {
  if (FindCameraModel(camera_model) == nullptr) {
    std::string names;
    for (const CameraModel* model : AllCameraModels()) {
      names += (names.empty() ? "" : ", ") + model->Name();
    }
    throw UsageError("--Simulator.camera_model '" + camera_model +
                     "' does not exist. COLMAP has: " + names + ".");
  }
  if (unit != "m" && unit != "mm") {
    throw UsageError("--Simulator.unit must be m or mm, but is '" + unit +
                     "'.");
  }
  const double half_diagonal = 0.5 * std::hypot(image_width, image_height);
  const double half_size = 0.5 * std::min(image_width, image_height);
  for (const Range& range : {
           Range{"num_cameras", double(num_cameras), 2, 10000},
           Range{"distance", distance, 0.25, 1000},
           Range{"azimuth", azimuth, 1, 180},
           Range{"min_elevation", min_elevation, -80, 80},
           Range{"max_elevation", max_elevation, -80, 80},
           Range{"image_width", double(image_width), 64, 65536},
           Range{"image_height", double(image_height), 64, 65536},
           Range{"focal_length_sigma", focal_length_sigma, 0, 0.05},
           Range{"principal_point_sigma",
                 principal_point_sigma,
                 0,
                 0.1 * half_size},
           Range{"distortion", distortion, 0, 0.05},
           Range{"num_frames", double(num_frames), 1, 1000000},
           Range{"num_points", double(num_points), 10, 10000000},
           Range{"min_views", double(min_views), 2, double(num_cameras)},
           Range{"max_views", double(max_views), 2, 10000},
           Range{"max_view_angle", max_view_angle, 10, 80},
           Range{"missing_share", missing_share, 0, 0.9},
           Range{"noise", noise, 0, 0.1 * half_size},
           Range{"outlier_share", outlier_share, 0, 0.9},
           Range{"min_outlier", min_outlier, 0, half_size},
           Range{"max_outlier", max_outlier, 0, half_size},
           Range{"unmatched_share", unmatched_share, 0, 100},
           Range{"initial_focal_length_sigma",
                 initial_focal_length_sigma,
                 0,
                 0.1},
           Range{"initial_principal_point_sigma",
                 initial_principal_point_sigma,
                 0,
                 0.5 * half_size},
           Range{"initial_distortion_sigma", initial_distortion_sigma, 0, 0.02},
           Range{"rig_rotation_sigma", rig_rotation_sigma, 0, 10},
           Range{"rig_center_sigma", rig_center_sigma, 0, 1000},
           Range{"blur", blur, 0, 20},
           Range{"image_noise", image_noise, 0, 100},
           Range{"gloss", gloss, 0, 1},
           Range{"seed", double(seed), 0, 2147483647},
       }) {
    CheckRange(range);
  }
  CheckOrder("min_elevation", min_elevation, "max_elevation", max_elevation);
  CheckOrder("min_views", min_views, "max_views", max_views);
  CheckOrder("min_outlier", min_outlier, "max_outlier", max_outlier);
  // A wider lens leaves the range in which all camera models can be inverted.
  if (focal_length != 0.0) {
    CheckRange({"focal_length", focal_length, half_diagonal / 1.2, 1e7});
  }
  if (num_threads == 0 || num_threads < -1 || num_threads > 1024) {
    throw UsageError(
        "--Simulator.num_threads must be 1 to 1024, or -1 for all.");
  }
}

}  // namespace mfir
