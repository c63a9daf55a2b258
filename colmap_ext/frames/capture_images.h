// The image files of a capture, whatever their layout (image_layout.h).

#pragma once

#include <string>
#include <vector>

#include "src/sensor/camera_naming.h"
#include "src/sensor/image_layout.h"

namespace mfir {

struct CaptureImage {
  // As models and databases call it: relative to IMAGES/FRAME where images lie
  // by frame, else to IMAGES.
  std::string name;
  std::string camera;  // canonical; may be a name that RIG has not
  std::string path;
};

struct CaptureFrame {
  std::string name;
  std::vector<CaptureImage> images;
};

struct CaptureImages {
  // Of the log: "images by camera: cam00/000000.png".
  std::string description;
  std::vector<CaptureFrame> frames;  // in the order of their names
  // Image files that are in no frame, relative to IMAGES.
  std::vector<std::string> left_out;
};

// Finds all images in `image_path`, those of the frames in `frame_list_path` if
// that is not empty. `rig_cameras`: canonical names. Where images lie by frame,
// a sub-folder without images is a frame, too. Throws InputError: no such
// folder, no frame, a frame of the list that does not exist, and what
// FindImageLayout throws.
CaptureImages FindCaptureImages(const std::string& image_path,
                                const std::string& frame_list_path,
                                const std::vector<std::string>& rig_cameras,
                                const CameraNaming& naming,
                                const std::string& frame_name_regex);

}  // namespace mfir
