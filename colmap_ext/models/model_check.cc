#include "colmap_ext/models/model_check.h"

#include <algorithm>
#include <cmath>
#include <unordered_set>
#include <vector>

#include "colmap_ext/models/camera_models.h"
#include "src/util/errors.h"
#include "src/util/parse_number.h"

namespace mfir {
namespace {

// Beyond these, numbers are no coordinates but damage.
constexpr double kMaxCoordinatePx = 1e7;

const size_t kMaxImageSize = 1000000;  // pixels per side

std::string ImageEntry(const host::Image& image) {
  return "image " + std::to_string(image.ImageId()) + " (" + image.Name() + ")";
}

void CheckCamera(const std::string& path, const host::Camera& camera) {
  const std::string entry = "camera " + std::to_string(host::CameraId(camera));
  const size_t width = host::Width(camera);
  const size_t height = host::Height(camera);
  for (const size_t size : {width, height}) {
    if (size == 0 || size > kMaxImageSize) {
      FailModel(path,
                entry,
                "image size " + std::to_string(width) + " x " +
                    std::to_string(height) + " is not between 1 and " +
                    std::to_string(kMaxImageSize) + " pixels");
    }
  }
  const std::string problem = IntrinsicsProblem(
      *FindCameraModel(host::ModelId(camera)), host::Params(camera));
  if (!problem.empty()) FailModel(path, entry, problem);
}

void CheckImage(const std::string& path, const host::Image& image) {
  const Rigid3 cam_from_world = host::CamFromWorld(image);
  if (!(std::abs(cam_from_world.rotation.norm() - 1.0) < 1e-6)) {
    FailModel(path, ImageEntry(image), "the rotation is not finite");
  }
  const std::string problem = CoordinateProblem(cam_from_world.translation);
  if (!problem.empty()) {
    FailModel(path, ImageEntry(image), "the translation " + problem);
  }
  if (std::any_of(image.Name().begin(), image.Name().end(), [](char c) {
        return c == '\n' || c == '\r' || c == '\t';
      })) {
    FailModel(path, ImageEntry(image), "line breaks or tabs in the image name");
  }
  size_t point2D_idx = 0;
  for (const host::Point2D& point2D : image.Points2D()) {
    const Eigen::Vector2d& xy = host::Xy(point2D);
    if (!xy.allFinite() || xy.cwiseAbs().maxCoeff() > kMaxCoordinatePx) {
      FailModel(path,
                ImageEntry(image),
                "observation " + std::to_string(point2D_idx) +
                    " is not finite or absurdly far from the image");
    }
    ++point2D_idx;
  }
}

void CheckImages(const std::string& path,
                 const host::Reconstruction& reconstruction) {
  std::unordered_set<std::string> names;
  for (const auto& [image_id, image] : reconstruction.Images()) {
    CheckImage(path, image);
    if (!names.insert(image.Name()).second) {
      FailModel(path, ImageEntry(image), "another image has the same name");
    }
  }
}

[[noreturn]] void FailForObservationsWithoutTrack(
    const ModelFiles& files, const host::Reconstruction& reconstruction) {
  for (const auto& [image_id, image] : reconstruction.Images()) {
    for (host::point2D_t i = 0; i < image.NumPoints2D(); ++i) {
      const host::Point2D& point2D = image.Point2D(i);
      if (point2D.HasPoint3D() &&
          !reconstruction.ExistsPoint3D(host::Point3DId(point2D))) {
        FailModel(files.images,
                  ImageEntry(image),
                  "observation " + std::to_string(i) +
                      " is of the unknown point " +
                      std::to_string(host::Point3DId(point2D)));
      }
    }
  }
  FailModel(
      files.images,
      "observations",
      "some are of points in " + files.points3D +
          " whose tracks do not name them: the files are not of one model");
}

void CheckPoints3D(const ModelFiles& files,
                   const host::Reconstruction& reconstruction) {
  size_t num_track_elements = 0;
  for (const auto& [point3D_id, point3D] : reconstruction.Points3D()) {
    const std::string problem = CoordinateProblem(host::Xyz(point3D));
    if (!problem.empty()) {
      FailModel(files.points3D,
                "point " + std::to_string(point3D_id),
                "the position " + problem);
    }
    num_track_elements += host::TrackOf(point3D).Length();
  }
  // Every track element has an observation of its own, so the counts differ
  // only if an observation is in no track.
  size_t num_observations = 0;
  for (const auto& [image_id, image] : reconstruction.Images()) {
    num_observations += image.NumPoints3D();
  }
  if (num_observations != num_track_elements) {
    FailForObservationsWithoutTrack(files, reconstruction);
  }
}

}  // namespace

void FailModel(const std::string& path,
               const std::string& entry,
               const std::string& what) {
  throw InputError(path + ": " + entry + ": " + what +
                   ". Correct the file, or export the model again.");
}

std::string CoordinateProblem(const Eigen::Vector3d& coordinates) {
  constexpr double kMaxCoordinate = 1e15;  // world units
  for (const double value : coordinates) {
    if (!(std::abs(value) <= kMaxCoordinate)) {
      return "has the coordinate " + FormatNumber(value) +
             ", which is not between -1e15 and 1e15";
    }
  }
  return "";
}

std::string IntrinsicsProblem(const CameraModel& model,
                              const std::vector<double>& params) {
  for (size_t i = 0; i < params.size(); ++i) {
    if (!std::isfinite(params[i])) {
      return "parameter " + std::to_string(i + 1) + " is not finite";
    }
  }
  for (const size_t idx : model.FocalLengthIdxs()) {
    if (!(params[idx] > 0.0 && params[idx] <= kMaxCoordinatePx)) {
      return "focal length " + FormatNumber(params[idx]) +
             (params[idx] > 0.0 ? " is above 1e7 px" : " is not positive");
    }
  }
  for (const size_t idx : model.PrincipalPointIdxs()) {
    if (std::abs(params[idx]) > kMaxCoordinatePx) {
      return "principal point coordinate " + FormatNumber(params[idx]) +
             " is not between -1e7 and 1e7 px";
    }
  }
  return "";
}

void CheckModelValues(const ModelFiles& files,
                      const host::Reconstruction& reconstruction) {
  for (const auto& [camera_id, camera] : reconstruction.Cameras()) {
    CheckCamera(files.cameras, camera);
  }
  CheckImages(files.images, reconstruction);
  CheckPoints3D(files, reconstruction);
}

}  // namespace mfir
