// What report.html shows, as values: filled from a result of the refiner by
// colmap_ext/report, written by report_page.h.

#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>
#include <nlohmann/json.hpp>

#include "src/evaluation/drift_check.h"
#include "src/geometry/rigid3.h"
#include "src/sensor/camera_model.h"

namespace mfir {

// What was seen in a cell of an image's grid.
struct ResidualCell {
  uint32_t num_observations = 0;  // outliers among them
  uint32_t num_inliers = 0;
  // Of the inliers' residuals (projection - keypoint), px.
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
};

constexpr int kResidualColumns = 14;
constexpr int kResidualRows = 10;

// Observations of a camera in all frames, by their place in the image.
struct ResidualMap {
  std::vector<ResidualCell> cells = std::vector<ResidualCell>(
      kResidualColumns * kResidualRows);  // row by row
};

// Observations of a camera in a frame.
struct FrameCell {
  uint32_t num_observations = 0;
  uint32_t num_inliers = 0;
  double sum_squared = 0.0;  // of the inliers' residual norms, px^2
};

// Residual components (x and y alike) of all observations, by size.
struct ResidualHistogram {
  double bin_width = 0.0;        // px
  std::vector<uint64_t> counts;  // |component| in bin_width * [i, i + 1)
  uint64_t num_larger = 0;       // beyond the last bin
};

// Intrinsics of a camera somewhere else: in RIG, at the start, yesterday.
// Without model and parameters where the camera is not there.
struct CameraValues {
  const CameraModel* model = nullptr;
  std::vector<double> params;
  std::vector<double> params_std;  // NaN: not known; empty: none is
};

struct ReportCamera {
  std::string name;
  const CameraModel* model = nullptr;
  std::vector<std::string> param_names;  // as COLMAP's
  size_t width = 0;
  size_t height = 0;
  size_t num_observations = 0;
  std::vector<double> params;
  std::vector<double> params_std;  // NaN: undetermined
  Eigen::MatrixXd covariance;      // of the parameters; NaN: undetermined
  Rigid3 cam_from_world;
  std::vector<std::string> flags;
  ResidualMap residuals;
};

// The same cameras at another time.
struct Comparison {
  std::string label;                  // "the start", "RIG", or the folder
  std::string created;                // time of that refinement, may be empty
  std::vector<CameraValues> cameras;  // as Report::cameras
  // Changes since then, see drift_check.h.
  std::vector<std::optional<CameraDrift>> drifts;
  // Whether it is a result with standard deviations of its own.
  bool is_result = false;
};

struct ExamplePoint {
  Eigen::Vector2d keypoint;
  Eigen::Vector2d projection_before;  // with the intrinsics of the start
  Eigen::Vector2d projection_after;
};

struct ExampleImage {
  size_t camera_idx = 0;
  std::string frame_name;
  std::string image_name;
  std::string jpeg_base64;
  std::vector<ExamplePoint> points;  // inliers
};

struct ScenePoint {
  Eigen::Vector3d xyz;
  Eigen::Matrix<uint8_t, 3, 1> color;
};

struct Report {
  nlohmann::ordered_json summary;        // summary.json
  std::string history_csv;               // history.csv
  std::string output_path;               // the folder with the result
  std::vector<ReportCamera> cameras;     // as summary["cameras"]
  std::vector<std::string> frame_names;  // used ones
  // frame_idx * cameras.size() + camera_idx
  std::vector<FrameCell> matrix;
  ResidualHistogram histogram;
  double max_inlier_px = 0.0;
  std::vector<ScenePoint> points;  // some of the first frame's
  Comparison start;
  Comparison rig;  // without any camera: RIG has no intrinsics to compare
  std::vector<Comparison> earlier;  // results of --compare_path, oldest first
  std::vector<ExampleImage> examples;
  std::string examples_remark;  // why there are none
};

}  // namespace mfir
