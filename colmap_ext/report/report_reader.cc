#include "colmap_ext/report/report_reader.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <stdexcept>
#include <utility>
#include <vector>

#include "colmap_ext/host/reconstruction.h"
#include "colmap_ext/io/input_file.h"
#include "colmap_ext/models/camera_models.h"
#include "colmap_ext/models/model_io.h"
#include "colmap_ext/report/example_images.h"
#include "colmap_ext/report/summary_reader.h"
#include "src/parallel/parallel_for.h"
#include "src/report/html.h"
#include "src/report/residuals.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr size_t kMaxArrayPoints = 2500;  // in the picture of the array
constexpr int kNumBins = 48;
constexpr double kHistogramStds = 6.0;

// The camera of the rig that an image has taken: its id is the index + 1.
size_t CameraIdx(const Report& report,
                 const std::string& path,
                 host::camera_t camera_id) {
  if (camera_id < 1 || camera_id > report.cameras.size()) {
    throw InputError(path + ": camera " + std::to_string(camera_id) +
                     " is not in summary.json. Give a folder as "
                     "multi_frame_intrinsics_refiner has written it.");
  }
  return camera_id - 1;
}

void ReadPoses(const std::string& path, Report* report) {
  const std::string rig_path = (fs::path(path) / "rig").string();
  host::Reconstruction rig;
  ReadModel(rig_path, /*require_points=*/false, &rig);
  for (const auto& id_and_image : rig.Images()) {
    const host::Image& image = id_and_image.second;
    report->cameras[CameraIdx(*report, rig_path, image.CameraId())]
        .cam_from_world = host::CamFromWorld(image);
  }
}

struct ObservedResidual {
  size_t camera_idx;
  Eigen::Vector2d keypoint;
  Eigen::Vector2d residual;
};

// Of all observations of a frame.
std::vector<ObservedResidual> Residuals(const std::string& path,
                                        const host::Reconstruction& frame,
                                        const Report& report) {
  std::vector<ObservedResidual> residuals;
  for (const auto& id_and_point : frame.Points3D()) {
    const Eigen::Vector3d& xyz = host::Xyz(id_and_point.second);
    for (const host::TrackElement& element :
         host::TrackOf(id_and_point.second).Elements()) {
      const host::Image& image = frame.Image(element.image_id);
      const size_t camera_idx = CameraIdx(report, path, image.CameraId());
      const Eigen::Vector2d keypoint =
          host::Xy(image.Point2D(element.point2D_idx));
      residuals.push_back(
          {camera_idx,
           keypoint,
           ProjectPoint(*report.cameras[camera_idx].model,
                        host::Params(frame.Camera(image.CameraId())),
                        host::CamFromWorld(image),
                        xyz) -
               keypoint});
    }
  }
  return residuals;
}

// Adds what they say to the cells and the histogram.
void AddResiduals(size_t frame_idx,
                  const std::vector<ObservedResidual>& residuals,
                  Report* report) {
  const size_t num_cameras = report->cameras.size();
  for (const auto& [camera_idx, keypoint, residual] : residuals) {
    AddResidual(camera_idx, keypoint, residual, report);
    FrameCell& cell = report->matrix[frame_idx * num_cameras + camera_idx];
    ++cell.num_observations;
    if (!(residual.norm() <= report->max_inlier_px)) continue;
    ++cell.num_inliers;
    cell.sum_squared += residual.squaredNorm();
  }
}

// Every n-th point, in the order of their ids.
void AddScenePoints(const host::Reconstruction& frame, Report* report) {
  std::vector<host::point3D_t> ids;
  for (const auto& id_and_point : frame.Points3D()) {
    ids.push_back(id_and_point.first);
  }
  std::sort(ids.begin(), ids.end());
  const size_t step = std::max<size_t>(1, ids.size() / kMaxArrayPoints);
  for (size_t i = 0; i < ids.size(); i += step) {
    const host::Point3D& point = frame.Point3D(ids[i]);
    // Simulated points have no colour.
    const host::Color color = host::ColorOf(point);
    report->points.push_back(
        {host::Xyz(point),
         color.maxCoeff() == 0 ? host::Color(150, 170, 190) : color});
  }
}

// The folder in `frames_path` of a frame by its name in the summary, where
// characters that are no UTF-8 have been replaced.
std::string FrameFolder(const fs::path& frames_path, const std::string& name) {
  const fs::path folder = frames_path / name;
  std::error_code error;
  if (fs::exists(folder, error)) return folder.string();
  for (fs::directory_iterator it(frames_path, error), end; !error && it != end;
       it.increment(error)) {
    const Json written =
        Json::parse(Json(it->path().filename().string())
                        .dump(-1, ' ', false, Json::error_handler_t::replace));
    if (written == name) return it->path().string();
  }
  return folder.string();
}

void ReadFrames(const std::string& path, Report* report) {
  for (const Json& frame : report->summary["frames"]) {
    if (TextAt(frame, "/status") == "used") {
      report->frame_names.push_back(frame.at("name").get<std::string>());
    }
  }
  report->matrix.resize(report->frame_names.size() * report->cameras.size());
  struct Frame {
    std::vector<ObservedResidual> residuals;
    host::Reconstruction model;  // of the first only
  };
  ParallelInOrder(
      0,
      report->frame_names.size(),
      -1,
      [&](size_t f) {
        const std::string frame_path =
            FrameFolder(fs::path(path) / "frames", report->frame_names[f]);
        host::Reconstruction model;
        ReadModel(frame_path, /*require_points=*/true, &model);
        Frame frame = {Residuals(frame_path, model, *report), {}};
        if (f == 0) frame.model = std::move(model);
        return frame;
      },
      [&](size_t f, const Frame& frame) {
        AddResiduals(f, frame.residuals, report);
        if (f > 0) return;
        AddScenePoints(frame.model, report);
        AddExamples(report->frame_names[f], frame.model, report);
      });
}

// Results of before the field was there: 4 standard deviations.
double MaxInlier(const Json& summary) {
  const double max_inlier = NumberAt(summary, "/result/max_inlier_px");
  if (std::isfinite(max_inlier)) return max_inlier;
  const double noise = NumberAt(summary, "/result/noise_std_px");
  return std::isfinite(noise) ? 4.0 * noise : 4.0;
}

void PrepareHistogram(Report* report) {
  const double noise = NumberAt(report->summary, "/result/noise_std_px");
  const double end =
      kHistogramStds * (std::isfinite(noise) && noise > 0.0 ? noise : 1.0);
  report->histogram.bin_width = end / kNumBins;
  report->histogram.counts.assign(kNumBins, 0);
}

void ReadComparisons(const std::vector<std::string>& compare_paths,
                     Report* report) {
  report->start = CompareWithStart(*report);
  report->rig = CompareWithRig(*report);
  for (const std::string& compare_path : compare_paths) {
    report->earlier.push_back(CompareWithResult(*report, compare_path));
  }
  std::vector<Comparison>& earlier = report->earlier;
  if (std::all_of(earlier.begin(), earlier.end(), [](const Comparison& c) {
        return !c.created.empty();
      })) {
    std::stable_sort(earlier.begin(),
                     earlier.end(),
                     [](const Comparison& a, const Comparison& b) {
                       return a.created < b.created;
                     });
  }
}

}  // namespace

Report ReadReport(const std::string& path,
                  const std::string& shown_path,
                  const std::vector<std::string>& compare_paths) {
  Report report;
  report.summary = ReadSummary(path);
  report.output_path = shown_path;
  const fs::path history_path = fs::path(path) / "history.csv";
  if (fs::exists(history_path)) {
    report.history_csv = ReadTextFile(history_path.string());
  }
  report.cameras = ReadCameras(path, report.summary);
  report.max_inlier_px = MaxInlier(report.summary);
  PrepareHistogram(&report);
  const auto fail = [&path](const std::exception& error) {
    throw InputError((fs::path(path) / "summary.json").string() + ": " +
                     error.what() +
                     ". Give a folder as multi_frame_intrinsics_refiner has "
                     "written it.");
  };
  try {
    ReadPoses(path, &report);
    ReadComparisons(compare_paths, &report);
    ReadFrames(path, &report);
  } catch (const Json::exception& error) {
    fail(error);
  } catch (const std::invalid_argument& error) {
    fail(error);
  }
  return report;
}

}  // namespace mfir
