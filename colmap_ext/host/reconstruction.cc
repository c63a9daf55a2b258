#include "colmap_ext/host/reconstruction.h"

#include <cmath>
#include <set>

namespace mfir::host {
namespace {

// As COLMAP 3.8 does: the same bits in all versions.
Eigen::Vector4d Normalized(const Eigen::Vector4d& qvec) {
  return qvec / qvec.norm();
}

}  // namespace

Eigen::Quaterniond StableQuaternion(const Eigen::Quaterniond& q) {
  const auto is_stable = [](const Eigen::Vector4d& qvec) {
    return Normalized(qvec) == qvec;
  };
  Eigen::Vector4d qvec(q.w(), q.x(), q.y(), q.z());
  for (int i = 0; i < 3 && !is_stable(qvec); ++i) {
    qvec = Normalized(qvec);
  }
  // About 1 % of all rotations alternate between neighbours for ever. Then a
  // component is moved by a few units in the last place.
  Eigen::Vector4d candidate = qvec;
  for (int num_ulps = 1; num_ulps <= 4 && !is_stable(candidate); ++num_ulps) {
    for (int i = 0; i < 8 && !is_stable(candidate); ++i) {
      candidate = qvec;
      for (int j = 0; j < num_ulps; ++j) {
        candidate(i / 2) =
            std::nextafter(candidate(i / 2), i % 2 == 0 ? 2.0 : -2.0);
      }
    }
  }
  return Eigen::Quaterniond(
      candidate(0), candidate(1), candidate(2), candidate(3));
}

Image CopyOfImage(const Image& image) {
  Image copy;
  copy.SetImageId(image.ImageId());
  copy.SetName(image.Name());
  copy.SetCameraId(image.CameraId());
  std::vector<Eigen::Vector2d> points2D;
  points2D.reserve(image.NumPoints2D());
  for (const Point2D& point2D : image.Points2D()) {
    points2D.push_back(Xy(point2D));
  }
  copy.SetPoints2D(points2D);
  return copy;
}

void AddPoints3D(const std::map<image_t, image_t>& image_ids,
                 const Reconstruction& from,
                 Reconstruction* to) {
  std::set<point3D_t> point3D_ids;
  for (const auto& [from_id, to_id] : image_ids) {
    for (const Point2D& point2D : from.Image(from_id).Points2D()) {
      if (point2D.HasPoint3D()) point3D_ids.insert(Point3DId(point2D));
    }
  }
  for (const point3D_t id : point3D_ids) {
    const Point3D& point3D = from.Point3D(id);
    Track track;
    for (const TrackElement& element : TrackOf(point3D).Elements()) {
      const auto it = image_ids.find(element.image_id);
      if (it != image_ids.end()) {
        track.AddElement(it->second, element.point2D_idx);
      }
    }
    const point3D_t new_id =
        to->AddPoint3D(Xyz(point3D), track, ColorOf(point3D));
    SetError(Error(point3D), &to->Point3D(new_id));
  }
}

Reconstruction ExtractImages(const std::vector<image_t>& image_ids,
                             const Reconstruction& reconstruction) {
  Reconstruction part;
  std::map<image_t, image_t> same_ids;
  for (const image_t image_id : image_ids) {
    const Image& image = reconstruction.Image(image_id);
    if (!part.ExistsCamera(image.CameraId())) {
      AddCameraWithTrivialRig(reconstruction.Camera(image.CameraId()), &part);
    }
    AddImageWithTrivialFrame(CopyOfImage(image), CamFromWorld(image), &part);
    same_ids.emplace(image_id, image_id);
  }
  AddPoints3D(same_ids, reconstruction, &part);
  return part;
}

}  // namespace mfir::host
