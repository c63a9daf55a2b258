// Copies of parts of reconstructions, the same in all versions of COLMAP.

#pragma once

#include <map>
#include <vector>

#include "colmap_ext/host/reconstruction.h"

namespace mfir::host {

// An image that no reconstruction owns, with its keypoints but no points.
Image CopyOfImage(const Image& image);

// Adds copies of the points of `from` that images of `image_ids` (registered,
// by their ids in `to`) see, and of the tracks what is in them; the points get
// new ids in the order of the old ones.
void AddPoints3D(const std::map<image_t, image_t>& image_ids,
                 const Reconstruction& from,
                 Reconstruction* to);

// The reconstruction of some of the registered images: they and their cameras
// keep their ids.
Reconstruction ExtractImages(const std::vector<image_t>& image_ids,
                             const Reconstruction& reconstruction);

}  // namespace mfir::host
