#include "colmap_ext/models/track_references.h"

#include <algorithm>
#include <utility>

#include "colmap_ext/models/model_check.h"

namespace mfir {

void TrackReferences::AddImage(uint32_t image_id,
                               const std::string& name,
                               std::vector<uint64_t> point3D_ids) {
  images_[image_id] = {name, std::move(point3D_ids)};
}

void TrackReferences::CheckTrack(const std::string& path,
                                 uint64_t point3D_id,
                                 std::vector<Element> track) const {
  const auto fail = [&](const std::string& what) {
    FailModel(path, "point " + std::to_string(point3D_id), what);
  };
  for (const Element& element : track) {
    const auto it = images_.find(element.image_id);
    if (it == images_.end()) {
      fail("its track names the unknown image " +
           std::to_string(element.image_id));
    }
    const Image& image = it->second;
    const auto fail_for = [&](const std::string& what) {
      fail("its track names observation " +
           std::to_string(element.point2D_idx) + " of image " +
           std::to_string(element.image_id) + " (" + image.name + "), which " +
           what);
    };
    if (element.point2D_idx >= image.point3D_ids.size()) {
      fail_for("has only " + std::to_string(image.point3D_ids.size()));
    }
    if (image.point3D_ids[element.point2D_idx] != point3D_id) {
      fail_for("is of another point");
    }
  }
  const auto key = [](const Element& element) {
    return std::make_pair(element.image_id, element.point2D_idx);
  };
  std::sort(
      track.begin(), track.end(), [&](const Element& a, const Element& b) {
        return key(a) < key(b);
      });
  if (std::adjacent_find(
          track.begin(), track.end(), [&](const Element& a, const Element& b) {
            return key(a) == key(b);
          }) != track.end()) {
    fail("its track names an observation twice");
  }
}

}  // namespace mfir
