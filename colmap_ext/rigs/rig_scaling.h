// Calibrations of another resolution.

#pragma once

#include <cstddef>
#include <string>

#include "colmap_ext/rig_formats/known_camera.h"

namespace mfir {

// Scales the intrinsics to images of this size, and sets it. False, and nothing
// changed, if the ratios of both sides differ by more than 0.1 %. The camera
// has a size.
bool ScaleToImageSize(size_t width, size_t height, KnownCamera* camera);

// What to do about images of `width` x `height` whose calibration is for
// another size: exchanged sides (an image that was rotated, by EXIF orientation
// say), another resolution, or neither. Ends with a full stop.
std::string ImageSizeAdvice(size_t width,
                            size_t height,
                            size_t calibration_width,
                            size_t calibration_height);

}  // namespace mfir
