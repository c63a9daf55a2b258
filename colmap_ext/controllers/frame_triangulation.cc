#include "colmap_ext/controllers/frame_triangulation.h"

#include <algorithm>
#include <cmath>
#include <map>

#include "colmap_ext/io/camera_models.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

// Reprojection errors have two components and come with the error of the
// point; epipolar errors of the drift have one.
constexpr double kReprojectionFactor = 3.0;

// The images of the database that belong to cameras of the rig, by camera.
std::vector<DatabaseImage> ReadImages(const CameraNaming& naming,
                                      const std::vector<RigCamera>& cameras,
                                      const colmap::Database& database,
                                      std::vector<std::string>* warnings) {
  std::map<std::string, size_t> camera_idxs;
  for (size_t i = 0; i < cameras.size(); ++i) camera_idxs[cameras[i].name] = i;
  std::vector<colmap::Image> database_images = database.ReadAllImages();
  std::vector<std::string> names;
  for (const colmap::Image& image : database_images) {
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
    DatabaseImage image{database_images[i].ImageId(), names[i], it->second, {}};
    const colmap::camera_t camera_id = database_images[i].CameraId();
    if (database.ExistsCamera(camera_id)) {
      const colmap::Camera stored = database.ReadCamera(camera_id);
      if (stored.Width() != camera.width || stored.Height() != camera.height) {
        throw InputError("database.db: image '" + names[i] + "' has " +
                         std::to_string(stored.Width()) + " x " +
                         std::to_string(stored.Height()) +
                         " pixels, but camera '" + camera.name + "' has " +
                         std::to_string(camera.width) + " x " +
                         std::to_string(camera.height));
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

colmap::Reconstruction MakeModel(const std::vector<RigCamera>& cameras,
                                 const std::vector<DatabaseImage>& images) {
  colmap::Reconstruction model;
  for (const DatabaseImage& frame_image : images) {
    const RigCamera& source = cameras[frame_image.camera_idx];
    colmap::Camera camera;
    camera.SetCameraId(
        static_cast<colmap::camera_t>(frame_image.camera_idx + 1));
    camera.SetModelId(CameraModelId(*source.model));
    camera.SetWidth(source.width);
    camera.SetHeight(source.height);
    camera.SetParams(source.params);
    model.AddCamera(camera);
    colmap::Image image;
    image.SetImageId(frame_image.image_id);
    image.SetCameraId(camera.CameraId());
    image.SetName(frame_image.name);
    SetCamFromWorld(source.cam_from_world, &image);
    model.AddImage(image);
    model.RegisterImage(frame_image.image_id);
  }
  return model;
}

// Thresholds that the user has not set follow from the epipolar tolerance.
void SetThresholds(double max_reproj_error,
                   double focal_length,
                   colmap::IncrementalTriangulator::Options* triangulation,
                   colmap::IncrementalMapper::Options* mapping) {
  const auto set = [](double value, double* option) {
    if (*option == 0.0) *option = value;
  };
  const double max_angle =
      colmap::RadToDeg(std::atan(max_reproj_error / focal_length));
  set(max_angle, &triangulation->create_max_angle_error);
  set(max_angle, &triangulation->continue_max_angle_error);
  set(max_angle, &triangulation->re_max_angle_error);
  set(max_reproj_error, &triangulation->merge_max_reproj_error);
  set(max_reproj_error, &triangulation->complete_max_reproj_error);
  set(max_reproj_error, &mapping->filter_max_reproj_error);
}

// The steps of COLMAP's point_triangulator (src/exe/sfm.cc), without its bundle
// adjustment: intrinsics are wrong, and points are the refiner's business.
void Triangulate(const TriangulatorOptions& options,
                 double max_reproj_error,
                 const std::vector<RigCamera>& cameras,
                 const std::vector<DatabaseImage>& images,
                 const colmap::Database& database,
                 colmap::Reconstruction* model) {
  std::unordered_set<std::string> image_names;
  std::vector<double> focal_lengths;
  for (const DatabaseImage& image : images) {
    image_names.insert(image.name);
    focal_lengths.push_back(MeanFocalLength(cameras[image.camera_idx]));
  }
  colmap::DatabaseCache cache;
  cache.Load(database,
             static_cast<size_t>(options.min_num_matches),
             options.ignore_watermarks,
             image_names);
  colmap::IncrementalTriangulator::Options triangulation =
      options.triangulation;
  colmap::IncrementalMapper::Options mapping;
  mapping.filter_max_reproj_error = options.filter_max_reproj_error;
  mapping.filter_min_tri_angle = options.filter_min_tri_angle;
  SetThresholds(
      max_reproj_error, Quantile(focal_lengths, 0.5), &triangulation, &mapping);
  // RANSAC of the triangulation: the same for any order of frames.
  colmap::SetPRNGSeed(0);
  colmap::IncrementalMapper mapper(&cache);
  mapper.BeginReconstruction(model);
  for (const DatabaseImage& image : images) {
    // The cache drops images without matches.
    if (cache.ExistsImage(image.image_id)) {
      mapper.TriangulateImage(triangulation, image.image_id);
    }
  }
  mapper.CompleteTracks(triangulation);
  mapper.MergeTracks(triangulation);
  mapper.FilterPoints(mapping);
  mapper.EndReconstruction(/*discard=*/false);
}

size_t NumVerifiedPairs(const colmap::Database& database,
                        size_t min_num_matches,
                        FrameStatistics* statistics) {
  std::vector<std::pair<colmap::image_t, colmap::image_t>> image_pairs;
  std::vector<int> num_inliers;
  database.ReadTwoViewGeometryNumInliers(&image_pairs, &num_inliers);
  for (const int num : num_inliers) {
    if (static_cast<size_t>(num) < min_num_matches) continue;
    statistics->num_inlier_matches += num;
    ++statistics->num_pairs;
  }
  return statistics->num_pairs;
}

}  // namespace

colmap::Reconstruction TriangulateFrame(const TriangulatorOptions& options,
                                        const CameraNaming& naming,
                                        const std::vector<RigCamera>& cameras,
                                        int num_threads,
                                        colmap::Database* database,
                                        FrameStatistics* statistics,
                                        FrameTimings* timings,
                                        std::vector<std::string>* warnings) {
  colmap::Timer timer;
  timer.Start();
  std::vector<DatabaseImage> images =
      ReadImages(naming, cameras, *database, warnings);
  statistics->num_images = images.size();
  if (database->NumInlierMatches() == 0) {
    const colmap::DatabaseTransaction transaction(database);
    VerifyMatches(options, cameras, images, num_threads, *database, statistics);
  }
  if (NumVerifiedPairs(*database, options.min_num_matches, statistics) == 0) {
    throw InputError(
        "no pair of images has enough matches that fit the known extrinsics; "
        "are they those of this array?");
  }
  timings->verification = timer.ElapsedSeconds();
  timer.Restart();
  // Databases that come verified: COLMAP's own default tolerance.
  const double tolerance = statistics->large_tolerance > 0.0
                               ? statistics->large_tolerance
                               : options.sift_matching.max_error;
  colmap::Reconstruction model = MakeModel(cameras, images);
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
