#include "colmap_ext/host/reconstruction_parts.h"

#include <set>

namespace mfir::host {

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
