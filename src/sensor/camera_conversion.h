// Conversion between lens models.

#pragma once

#include <vector>

#include "src/sensor/camera_model.h"

namespace mfir {

// Parameters of `target` whose projections are closest, in the least squares
// sense over a grid of rays through the image (width x height pixels), to those
// of `source`. Exact where the target contains the source (e.g. RADIAL in
// OPENCV). Throws InputError if the source cannot unproject its own image.
std::vector<double> ConvertCameraParams(
    const CameraModel& source,
    const std::vector<double>& source_params,
    size_t width,
    size_t height,
    const CameraModel& target);

}  // namespace mfir
