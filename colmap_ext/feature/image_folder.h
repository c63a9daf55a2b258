// Images of a capture.

#pragma once

#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <utility>

#include "colmap_ext/host/image_file.h"
#include "src/dense/dense_features.h"

namespace mfir {

class ImageFolder {
 public:
  explicit ImageFolder(const std::string& path) : path_(path) {}

  const std::string& Path() const { return path_; }

  // IMAGES/FRAME/IMAGE_NAME, else IMAGES/IMAGE_NAME, else, by the names of
  // frame and camera, IMAGES/CAMERA/FRAME.ext, IMAGES/CAMERA/CAMERA_FRAME.ext,
  // IMAGES/CAMERA_FRAME.ext or IMAGES/FRAME_CAMERA.ext; "" if none exists.
  std::string Find(const DenseFeatureRequest& request) const;

  // ReadImage() of the image that is found. False if it does not exist.
  bool Read(const DenseFeatureRequest& request,
            bool as_rgb,
            host::Bitmap* bitmap) const;

 private:
  // Images by camera and frame.
  struct Index {
    std::once_flag once;
    std::map<std::pair<std::string, std::string>, std::string> paths;
  };

  void MakeIndex() const;

  std::string path_;
  std::shared_ptr<Index> index_ = std::make_shared<Index>();
};

// The image, converted as COLMAP does for its own features. Throws InputError:
// not readable, or not `width` x `height` pixels.
host::Bitmap ReadImage(const std::string& path,
                       int width,
                       int height,
                       bool as_rgb);

}  // namespace mfir
