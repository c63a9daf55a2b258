// From the images of RIG to its cameras.

#pragma once

#include <string>
#include <vector>

#include "colmap_ext/rig_formats/known_camera.h"
#include "src/sensor/camera_naming.h"

namespace mfir {

// Sets the names of the cameras, one per image so far, from image_name. Where
// several images have the same pose (many frames of a calibration capture), the
// rule is the one that gives exactly those the same name; else it is
// `naming`'s. An image that the regex of `naming` does not match goes by its
// own name.
void NameRigImages(const CameraNaming& naming,
                   std::vector<KnownCamera>* cameras);

// The cameras, sorted by name (CameraNameLess) and image name, with one entry
// for all images of the same name. Throws InputError, naming both images, if
// poses differ by more than 1e-6 (radians; share of the size of the rig) or if
// intrinsics differ. `path` is for messages.
std::vector<KnownCamera> MergeRigImages(const std::string& path,
                                        std::vector<KnownCamera> cameras);

}  // namespace mfir
