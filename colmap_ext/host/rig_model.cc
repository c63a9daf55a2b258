#include "colmap_ext/host/rig_model.h"

#include <algorithm>

#include "colmap_ext/host/reconstruction.h"

namespace mfir::host {

void RigModel::AddFrame(
    const std::function<std::string(const Image&)>& image_name,
    const Reconstruction& frame) {
  std::vector<image_t> old_ids = frame.RegImageIds();
  std::sort(old_ids.begin(), old_ids.end());
  std::map<image_t, image_t> new_ids;
  std::vector<Image> images;
  for (const image_t old_id : old_ids) {
    const Image& image = frame.Image(old_id);
    Image& copy = images.emplace_back(CopyOfImage(image));
    const auto new_id =
        static_cast<image_t>(model_.NumImages() + images.size());
    copy.SetImageId(new_id);
    copy.SetName(image_name(image));
    new_ids[old_id] = new_id;
  }
  AddImages(images);
  AddPoints3D(new_ids, frame, &model_);
}

}  // namespace mfir::host
