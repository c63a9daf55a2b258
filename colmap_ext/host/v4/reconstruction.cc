#include "colmap_ext/host/reconstruction.h"

#include <filesystem>

#include "colmap/scene/reconstruction_io_binary.h"
#include "colmap/scene/reconstruction_io_text.h"
#include "colmap_ext/host/v4/pose.h"

namespace mfir::host {
namespace {

// A copy that no reconstruction owns yet.
Image Detached(const Image& image) {
  Image copy;
  copy.SetImageId(image.ImageId());
  copy.SetName(image.Name());
  copy.SetCameraId(image.CameraId());
  copy.SetPoints2D(image.Points2D());
  return copy;
}

void NormalizeRotations(Reconstruction* reconstruction) {
  for (const image_t image_id : reconstruction->RegImageIds()) {
    Image& image = reconstruction->Image(image_id);
    Rigid3 pose = CamFromWorld(image);
    const Eigen::Quaterniond& q = pose.rotation;
    // In the order of 3.8: the same bits.
    Eigen::Vector4d qvec(q.w(), q.x(), q.y(), q.z());
    qvec /= qvec.norm();
    pose.rotation = Eigen::Quaterniond(qvec(0), qvec(1), qvec(2), qvec(3));
    SetCamFromWorld(pose, &image);
  }
}

}  // namespace

Rigid3 CamFromWorld(const Image& image) {
  const colmap::Rigid3d pose = image.CamFromWorld();
  return {Eigen::Quaterniond(pose.rotation()), pose.translation()};
}

void SetCamFromWorld(const Rigid3& cam_from_world, Image* image) {
  image->FramePtr()->SetCamFromWorld(image->CameraId(),
                                     ToColmap(cam_from_world));
}

void AddCameraWithTrivialRig(const Camera& camera,
                             Reconstruction* reconstruction) {
  reconstruction->AddCameraWithTrivialRig(camera);
}

void AddImageWithTrivialFrame(const Image& image,
                              const Rigid3& cam_from_world,
                              Reconstruction* reconstruction) {
  reconstruction->AddImageWithTrivialFrame(Detached(image),
                                           ToColmap(cam_from_world));
}

void DeRegisterImage(image_t image_id, Reconstruction* reconstruction) {
  reconstruction->DeRegisterFrame(reconstruction->Image(image_id).FrameId());
}

void SplitCameras(const std::vector<std::pair<image_t, camera_t>>& camera_ids,
                  Reconstruction* reconstruction) {
  Reconstruction split;
  for (const auto& [image_id, camera_id] : camera_ids) {
    const Image& image = reconstruction->Image(image_id);
    Camera camera = reconstruction->Camera(image.CameraId());
    camera.camera_id = camera_id;
    split.AddCameraWithTrivialRig(camera);
    Image copy = Detached(image);
    copy.SetCameraId(camera_id);
    split.AddImageWithTrivialFrame(std::move(copy), image.CamFromWorld());
  }
  for (const auto& [point3D_id, point3D] : reconstruction->Points3D()) {
    split.AddPoint3D(point3D_id, point3D);
  }
  *reconstruction = std::move(split);
}

const Eigen::Vector2d& Xy(const Point2D& point2D) { return point2D.xy; }

void SetXy(const Eigen::Vector2d& xy, Point2D* point2D) { point2D->xy = xy; }

point3D_t Point3DId(const Point2D& point2D) { return point2D.point3D_id; }

const Eigen::Vector3d& Xyz(const Point3D& point3D) { return point3D.xyz; }

Eigen::Vector3d& Xyz(Point3D* point3D) { return point3D->xyz; }

double Error(const Point3D& point3D) { return point3D.error; }

void SetError(double error, Point3D* point3D) { point3D->error = error; }

const Track& TrackOf(const Point3D& point3D) { return point3D.track; }

Color ColorOf(const Point3D& point3D) { return point3D.color; }

void TransformReconstruction(const Similarity3& new_from_old,
                             Reconstruction* reconstruction) {
  reconstruction->Transform(colmap::Sim3d(
      new_from_old.scale, new_from_old.rotation, new_from_old.translation));
}

void ReadReconstruction(const std::string& folder,
                        bool is_binary,
                        Reconstruction* reconstruction) {
  const std::filesystem::path path = folder;
  Reconstruction model;
  // Without rigs and frames COLMAP makes trivial ones.
  if (is_binary) {
    colmap::ReadCamerasBinary(model, path / "cameras.bin");
    colmap::ReadImagesBinary(model, path / "images.bin");
    colmap::ReadPoints3DBinary(model, path / "points3D.bin");
  } else {
    colmap::ReadCamerasText(model, path / "cameras.txt");
    colmap::ReadImagesText(model, path / "images.txt");
    colmap::ReadPoints3DText(model, path / "points3D.txt");
  }
  NormalizeRotations(&model);
  *reconstruction = std::move(model);
}

}  // namespace mfir::host
