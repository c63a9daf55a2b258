#include "colmap_ext/host/reconstruction.h"

#include <map>

#include "base/similarity_transform.h"

namespace mfir::host {
namespace {

Eigen::Vector4d Qvec(const Eigen::Quaterniond& q) {
  return {q.w(), q.x(), q.y(), q.z()};
}

}  // namespace

Rigid3 CamFromWorld(const Image& image) {
  const Eigen::Vector4d& qvec = image.Qvec();
  return {Eigen::Quaterniond(qvec(0), qvec(1), qvec(2), qvec(3)), image.Tvec()};
}

void SetCamFromWorld(const Rigid3& cam_from_world, Image* image) {
  image->SetQvec(Qvec(cam_from_world.rotation));
  image->SetTvec(cam_from_world.translation);
}

void AddCameraWithTrivialRig(const Camera& camera,
                             Reconstruction* reconstruction) {
  reconstruction->AddCamera(camera);
}

void AddImageWithTrivialFrame(const Image& image,
                              const Rigid3& cam_from_world,
                              Reconstruction* reconstruction) {
  Image posed = image;
  posed.SetRegistered(false);
  SetCamFromWorld(cam_from_world, &posed);
  reconstruction->AddImage(posed);
  reconstruction->RegisterImage(image.ImageId());
}

void DeRegisterImage(image_t image_id, Reconstruction* reconstruction) {
  reconstruction->DeRegisterImage(image_id);
}

void SplitCameras(const std::vector<std::pair<image_t, camera_t>>& camera_ids,
                  Reconstruction* reconstruction) {
  std::map<camera_t, Camera> cameras;
  for (const auto& [image_id, camera_id] : camera_ids) {
    Camera camera =
        reconstruction->Camera(reconstruction->Image(image_id).CameraId());
    camera.SetCameraId(camera_id);
    cameras.emplace(camera_id, camera);
  }
  for (const auto& [image_id, camera_id] : camera_ids) {
    reconstruction->Image(image_id).SetCameraId(camera_id);
  }
  for (const auto& [camera_id, camera] : cameras) {
    if (reconstruction->ExistsCamera(camera_id)) {
      reconstruction->Camera(camera_id) = camera;
    } else {
      reconstruction->AddCamera(camera);
    }
  }
  // Removes the images and cameras that are not used any more.
  reconstruction->TearDown();
}

const Eigen::Vector2d& Xy(const Point2D& point2D) { return point2D.XY(); }

void SetXy(const Eigen::Vector2d& xy, Point2D* point2D) { point2D->SetXY(xy); }

point3D_t Point3DId(const Point2D& point2D) { return point2D.Point3DId(); }

const Eigen::Vector3d& Xyz(const Point3D& point3D) { return point3D.XYZ(); }

Eigen::Vector3d& Xyz(Point3D* point3D) { return point3D->XYZ(); }

double Error(const Point3D& point3D) { return point3D.Error(); }

void SetError(double error, Point3D* point3D) { point3D->SetError(error); }

const Track& TrackOf(const Point3D& point3D) { return point3D.Track(); }

Color ColorOf(const Point3D& point3D) { return point3D.Color(); }

void TransformReconstruction(const Similarity3& new_from_old,
                             Reconstruction* reconstruction) {
  reconstruction->Transform(
      colmap::SimilarityTransform3(new_from_old.scale,
                                   Qvec(new_from_old.rotation),
                                   new_from_old.translation));
}

void ReadReconstruction(const std::string& folder,
                        bool is_binary,
                        Reconstruction* reconstruction) {
  if (is_binary) {
    reconstruction->ReadBinary(folder);
  } else {
    reconstruction->ReadText(folder);
  }
}

}  // namespace mfir::host
