#include "colmap_ext/model_check.h"

#include <algorithm>
#include <cmath>
#include <unordered_set>
#include <utility>
#include <vector>

#include "colmap_ext/compat.h"
#include "src/errors.h"

namespace mfir {
namespace {

const size_t kMaxImageSize = 1000000;  // pixels per side

[[noreturn]] void Fail(const std::string& path,
                       const std::string& entry,
                       const std::string& what) {
  throw InputError(path + ": " + entry + ": " + what +
                   ". Correct the file, or export the model again.");
}

std::string ImageEntry(const colmap::Image& image) {
  return "image " + std::to_string(image.ImageId()) + " (" + image.Name() + ")";
}

void CheckCamera(const std::string& path, const colmap::Camera& camera) {
  const std::string entry = "camera " + std::to_string(camera.CameraId());
  for (const size_t size : {camera.Width(), camera.Height()}) {
    if (size == 0 || size > kMaxImageSize) {
      Fail(path,
           entry,
           "image size " + std::to_string(camera.Width()) + " x " +
               std::to_string(camera.Height()) + " is not between 1 and " +
               std::to_string(kMaxImageSize) + " pixels");
    }
  }
  for (size_t i = 0; i < camera.Params().size(); ++i) {
    if (!std::isfinite(camera.Params()[i])) {
      Fail(
          path, entry, "parameter " + std::to_string(i + 1) + " is not finite");
    }
  }
  for (const size_t idx : camera.FocalLengthIdxs()) {
    if (camera.Params()[idx] <= 0.0) {
      Fail(path,
           entry,
           "focal length " + std::to_string(camera.Params()[idx]) +
               " is not positive");
    }
  }
}

void CheckImage(const std::string& path,
                const colmap::Image& image,
                const colmap::Reconstruction& reconstruction) {
  const Rigid3 cam_from_world = CamFromWorld(image);
  if (!cam_from_world.translation.allFinite() ||
      !(std::abs(cam_from_world.rotation.norm() - 1.0) < 1e-6)) {
    Fail(path, ImageEntry(image), "the pose is not finite");
  }
  if (std::any_of(image.Name().begin(), image.Name().end(), [](char c) {
        return c == '\n' || c == '\r' || c == '\t';
      })) {
    Fail(path, ImageEntry(image), "line breaks or tabs in the image name");
  }
  size_t point2D_idx = 0;
  for (const colmap::Point2D& point2D : image.Points2D()) {
    if (!point2D.XY().allFinite()) {
      Fail(path,
           ImageEntry(image),
           "observation " + std::to_string(point2D_idx) + " is not finite");
    }
    if (point2D.HasPoint3D() &&
        !reconstruction.ExistsPoint3D(point2D.Point3DId())) {
      Fail(path,
           ImageEntry(image),
           "observation " + std::to_string(point2D_idx) +
               " is of the unknown point " +
               std::to_string(point2D.Point3DId()));
    }
    ++point2D_idx;
  }
}

void CheckImages(const std::string& path,
                 const colmap::Reconstruction& reconstruction) {
  std::unordered_set<std::string> names;
  for (const auto& [image_id, image] : reconstruction.Images()) {
    CheckImage(path, image, reconstruction);
    if (!names.insert(image.Name()).second) {
      Fail(path, ImageEntry(image), "another image has the same name");
    }
  }
}

void CheckTrack(const std::string& path,
                colmap::point3D_t point3D_id,
                const colmap::Track& track,
                const colmap::Reconstruction& reconstruction) {
  const auto fail = [&](const std::string& what) {
    Fail(path, "point " + std::to_string(point3D_id), what);
  };
  std::vector<std::pair<colmap::image_t, colmap::point2D_t>> elements;
  elements.reserve(track.Length());
  for (const colmap::TrackElement& element : track.Elements()) {
    const auto image = reconstruction.Images().find(element.image_id);
    if (image == reconstruction.Images().end()) {
      fail("its track names the unknown image " +
           std::to_string(element.image_id));
    }
    const std::string observation = "observation " +
                                    std::to_string(element.point2D_idx) +
                                    " of " + ImageEntry(image->second);
    if (element.point2D_idx >= image->second.NumPoints2D()) {
      fail("its track names " + observation + ", which has only " +
           std::to_string(image->second.NumPoints2D()));
    }
    if (image->second.Point2D(element.point2D_idx).Point3DId() != point3D_id) {
      fail("its track names " + observation + ", which is of another point");
    }
    elements.emplace_back(element.image_id, element.point2D_idx);
  }
  std::sort(elements.begin(), elements.end());
  if (std::adjacent_find(elements.begin(), elements.end()) != elements.end()) {
    fail("its track names an observation twice");
  }
}

void CheckPoints3D(const ModelFiles& files,
                   const colmap::Reconstruction& reconstruction) {
  size_t num_track_elements = 0;
  for (const auto& [point3D_id, point3D] : reconstruction.Points3D()) {
    if (!point3D.XYZ().allFinite()) {
      Fail(files.points3D,
           "point " + std::to_string(point3D_id),
           "the position is not finite");
    }
    CheckTrack(files.points3D, point3D_id, point3D.Track(), reconstruction);
    num_track_elements += point3D.Track().Length();
  }
  // Every element has an observation of its own, so the rest is in no track.
  size_t num_observations = 0;
  for (const auto& [image_id, image] : reconstruction.Images()) {
    num_observations += image.NumPoints3D();
  }
  if (num_observations != num_track_elements) {
    Fail(files.images,
         "observations",
         std::to_string(num_observations) +
             " refer to points, but the tracks in " + files.points3D +
             " have only " + std::to_string(num_track_elements) +
             ": the files are not of one model");
  }
}

}  // namespace

void CheckModelValues(const ModelFiles& files,
                      const colmap::Reconstruction& reconstruction) {
  for (const auto& [camera_id, camera] : reconstruction.Cameras()) {
    CheckCamera(files.cameras, camera);
  }
  CheckImages(files.images, reconstruction);
  CheckPoints3D(files, reconstruction);
}

}  // namespace mfir
