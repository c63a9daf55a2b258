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

  // Reads and converts the image as COLMAP does for its own features. False if
  // it does not exist. Throws InputError: not readable, other size than the
  // request's.
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

}  // namespace mfir
