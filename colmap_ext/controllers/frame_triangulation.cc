#include "colmap_ext/controllers/frame_triangulation.h"

#include <algorithm>
#include <cmath>
#include <map>

#include "colmap_ext/host/triangulation.h"
#include "colmap_ext/host/util.h"
#include "colmap_ext/models/camera_models.h"
#include "colmap_ext/models/model_io.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

// Reprojection errors have two components and come with the error of the
// point; epipolar errors of the drift have one.
constexpr double kReprojectionFactor = 3.0;
// Of databases that come verified: COLMAP's own default, pixels.
constexpr double kVerifiedTolerance = 4.0;

// The images of the database that belong to cameras of the rig, by camera.
std::vector<DatabaseImage> ReadImages(const CameraNaming& naming,
                                      const std::vector<RigCamera>& cameras,
                                      const host::Database& database,
                                      std::vector<std::string>* warnings) {
  std::map<std::string, size_t> camera_idxs;
  for (size_t i = 0; i < cameras.size(); ++i) camera_idxs[cameras[i].name] = i;
  std::vector<host::Image> database_images = database.ReadAllImages();
  std::vector<std::string> names;
  for (const host::Image& image : database_images) {
    names.push_back(image.Name());
  }
  const std::vector<std::string> camera_names = naming.Names(names);
  std::map<size_t, DatabaseImage> images;
  std::vector<std::string> without_camera;
  for (size_t i = 0; i < names.size(); ++i) {
    const auto it = camera_idxs.find(camera_names[i]);
    if (it == camera_idxs.end()) {
      without_camera.push_back(names[i]);
      continue;
    }
    const RigCamera& camera = cameras[it->second];
    DatabaseImage image{database_images[i].ImageId(), names[i], it->second};
    const host::camera_t camera_id = database_images[i].CameraId();
    if (database.ExistsCamera(camera_id)) {
      const host::Camera stored = database.ReadCamera(camera_id);
      const size_t width = host::Width(stored);
      const size_t height = host::Height(stored);
      if (width != camera.width || height != camera.height) {
        throw InputError("database.db: image '" + names[i] + "' has " +
                         std::to_string(width) + " x " +
                         std::to_string(height) + " pixels, but camera '" +
                         camera.name + "' has " + std::to_string(camera.width) +
                         " x " + std::to_string(camera.height));
      }
    }
    const auto inserted = images.emplace(it->second, std::move(image));
    if (!inserted.second) {
      throw InputError("the images '" + inserted.first->second.name +
                       "' and '" + names[i] + "' belong to the same camera '" +
                       camera.name + "'; set --MultiFrame.camera_name_regex");
    }
  }
  if (!without_camera.empty()) {
    warnings->push_back(std::to_string(without_camera.size()) +
                        " images of the database belong to no camera of the "
                        "rig and are left out; the first: " +
                        without_camera.front());
  }
  if (images.size() < 2) {
    throw InputError(std::to_string(images.size()) +
                     " images of cameras of the rig; at least 2 are needed");
  }
  std::vector<DatabaseImage> result;
  for (auto& idx_and_image : images) {
    result.push_back(std::move(idx_and_image.second));
  }
  return result;
}

host::Reconstruction MakeModel(const std::vector<RigCamera>& cameras,
                               const std::vector<DatabaseImage>& images) {
  host::Reconstruction model;
  for (const DatabaseImage& frame_image : images) {
    AddPosedImage(frame_image.image_id,
                  frame_image.name,
                  static_cast<host::camera_t>(frame_image.camera_idx + 1),
                  cameras[frame_image.camera_idx],
                  &model);
  }
  return model;
}

// Thresholds that the user has not set follow from the epipolar tolerance.
void SetThresholds(double max_reproj_error,
                   double focal_length,
                   host::TriangulationOptions* options) {
  const auto set = [](double value, double* option) {
    if (*option == 0.0) *option = value;
  };
  const double max_angle =
      host::RadToDeg(std::atan(max_reproj_error / focal_length));
  host::TriangulatorOptions* triangulator = &options->triangulator;
  set(max_angle, &triangulator->create_max_angle_error);
  set(max_angle, &triangulator->continue_max_angle_error);
  set(max_angle, &triangulator->re_max_angle_error);
  set(max_reproj_error, &triangulator->merge_max_reproj_error);
  set(max_reproj_error, &triangulator->complete_max_reproj_error);
  set(max_reproj_error, &options->filter_max_reproj_error);
}

// Without bundle adjustment: intrinsics are wrong, and points are the refiner's
// business.
void Triangulate(const TriangulatorOptions& options,
                 double max_reproj_error,
                 const std::vector<RigCamera>& cameras,
                 const std::vector<DatabaseImage>& images,
                 const host::Database& database,
                 host::Reconstruction* model) {
  std::vector<host::image_t> image_ids;
  std::vector<double> focal_lengths;
  for (const DatabaseImage& image : images) {
    image_ids.push_back(image.image_id);
    focal_lengths.push_back(MeanFocalLength(cameras[image.camera_idx]));
  }
  host::TriangulationOptions triangulation;
  triangulation.triangulator = options.triangulation;
  triangulation.min_num_matches = static_cast<size_t>(options.min_num_matches);
  triangulation.ignore_watermarks = options.ignore_watermarks;
  triangulation.filter_max_reproj_error = options.filter_max_reproj_error;
  triangulation.filter_min_tri_angle = options.filter_min_tri_angle;
  SetThresholds(max_reproj_error, Quantile(focal_lengths, 0.5), &triangulation);
  host::TriangulateImages(triangulation, database, image_ids, model);
}

size_t NumVerifiedPairs(const host::Database& database,
                        size_t min_num_matches,
                        FrameStatistics* statistics) {
  for (const size_t num : host::ReadNumInlierMatches(database)) {
    if (num < min_num_matches) continue;
    statistics->num_inlier_matches += num;
    ++statistics->num_pairs;
  }
  return statistics->num_pairs;
}

}  // namespace

host::Reconstruction TriangulateFrame(
    const TriangulatorOptions& options,
    const CameraNaming& naming,
    const std::vector<RigCamera>& cameras,
    const std::vector<std::pair<size_t, size_t>>& pairs,
    int num_threads,
    const ProgressFunction& progress,
    host::Database* database,
    FrameStatistics* statistics,
    FrameTimings* timings,
    std::vector<std::string>* warnings) {
  host::Timer timer;
  timer.Start();
  std::vector<DatabaseImage> images =
      ReadImages(naming, cameras, *database, warnings);
  statistics->num_images = images.size();
  if (database->NumInlierMatches() == 0) {
    const host::DatabaseTransaction transaction(database);
    VerifyMatches(options,
                  cameras,
                  images,
                  pairs,
                  num_threads,
                  progress,
                  database,
                  statistics);
  }
  // COLMAP is silent about a transaction that could not be written.
  if (statistics->large_tolerance > 0.0 && database->NumInlierMatches() == 0) {
    throw OutputError("database.db: cannot write the file. Is the disk full?");
  }
  if (NumVerifiedPairs(*database, options.min_num_matches, statistics) == 0) {
    throw InputError(
        "no pair of images has enough matches that fit the known extrinsics; "
        "are they those of this array?");
  }
  timings->verification = timer.ElapsedSeconds();
  timer.Restart();
  const double tolerance = statistics->large_tolerance > 0.0
                               ? statistics->large_tolerance
                               : kVerifiedTolerance;
  host::Reconstruction model = MakeModel(cameras, images);
  Triangulate(options,
              kReprojectionFactor * tolerance,
              cameras,
              images,
              *database,
              &model);
  statistics->num_points = model.NumPoints3D();
  statistics->num_observations = model.ComputeNumObservations();
  if (statistics->num_points == 0) {
    throw InputError("no point could be triangulated");
  }
  timings->triangulation = timer.ElapsedSeconds();
  return model;
}

}  // namespace mfir
