// Which point each observation is of, as the files of a model say: images name
// points and points name observations. COLMAP 3.8 believes both, COLMAP 4 ends
// with a text of its own where they disagree, so this is checked before either
// reads them.

#pragma once

#include <cstdint>
#include <string>
#include <unordered_map>
#include <vector>

namespace mfir {

class TrackReferences {
 public:
  struct Element {
    uint32_t image_id = 0;
    uint32_t point2D_idx = 0;
  };

  // The points that the image's observations are of.
  void AddImage(uint32_t image_id,
                const std::string& name,
                std::vector<uint64_t> point3D_ids);

  // Throws InputError naming `path` and the point. All images have been added.
  void CheckTrack(const std::string& path,
                  uint64_t point3D_id,
                  std::vector<Element> track) const;

 private:
  struct Image {
    std::string name;
    std::vector<uint64_t> point3D_ids;
  };

  std::unordered_map<uint32_t, Image> images_;
};

}  // namespace mfir
