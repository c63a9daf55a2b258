// Which part of an image's path is its camera and which its frame.

#pragma once

#include <string>
#include <vector>

#include "src/sensor/camera_naming.h"

namespace mfir {

enum class ImageLayout {
  kByFrame,          // FRAME/CAMERA.ext
  kByCamera,         // CAMERA/FRAME.ext or CAMERA/CAMERA_FRAME.ext
  kFlatCameraFirst,  // CAMERA_FRAME.ext
  kFlatFrameFirst,   // FRAME_CAMERA.ext
  kByRegexes,        // as two regular expressions say
};

// "images by camera".
std::string DescribeImageLayout(ImageLayout layout);

struct LocatedImage {
  std::string path;  // relative to IMAGES, with '/'
  std::string frame;
  std::string camera;  // canonical; may be a name that RIG has not
};

struct ImageReading {
  ImageLayout layout = ImageLayout::kByFrame;
  std::vector<LocatedImage> images;  // that have a frame
  // The first with a camera of RIG, for messages; -1: none has one.
  int first_known = -1;
};

// The layout in which the paths (relative to IMAGES, with '/') name the cameras
// of RIG (canonical names). Several may fit where names are numbers: then the
// one that explains twice as much as every other, counted in images times the
// share of RIG's cameras that have some. The layout is kByFrame if none fits.
//
// frame_name_regex   if not empty, only layouts count whose frames are what it
//                    captures; together with a regex of `naming` the two decide
//                    alone. Both are searched in the path.
//
// Throws UsageError for a bad regex; InputError, with two readings of a path
// and the option that decides, if several layouts fit, and if none agrees with
// the regex.
ImageReading FindImageLayout(const std::vector<std::string>& paths,
                             const std::vector<std::string>& rig_cameras,
                             const CameraNaming& naming,
                             const std::string& frame_name_regex);

}  // namespace mfir
