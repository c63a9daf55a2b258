// The frames of COLMAP 4's models: which images were taken at the same time.
// COLMAP 3.8 has none, but its build reads those of COLMAP 4, too.

#pragma once

#include <string>
#include <vector>

#include "colmap_ext/host/reconstruction.h"

namespace mfir {

// Ids of the images of each frame, in the order of the frames' ids: from
// frames.bin or frames.txt beside the model in folder `path` that ReadModel
// reads. Sensors that are no cameras are left aside. Empty without such a file.
// Throws InputError, naming the file and the frame or line, for a damaged file,
// an image of two frames, and images of `reconstruction`, the model, that are
// of no frame.
std::vector<std::vector<host::image_t>> ReadModelFrames(
    const std::string& path, const host::Reconstruction& reconstruction);

}  // namespace mfir
