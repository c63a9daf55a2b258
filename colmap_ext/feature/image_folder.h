// Images of a capture.

#pragma once

#include <string>

#include "colmap_ext/host/image_file.h"
#include "src/feature/dense_features.h"

namespace mfir {

class ImageFolder {
 public:
  explicit ImageFolder(const std::string& path) : path_(path) {}

  const std::string& Path() const { return path_; }

  // IMAGES/FRAME/IMAGE_NAME, else IMAGES/IMAGE_NAME; "" if neither exists.
  std::string Find(const std::string& frame_name,
                   const std::string& image_name) const;

  // Reads and converts the image as COLMAP does for its own features. False if
  // it does not exist. Throws InputError: not readable, other size than the
  // request's.
  bool Read(const DenseFeatureRequest& request,
            bool as_rgb,
            host::Bitmap* bitmap) const;

 private:
  const std::string path_;
};

}  // namespace mfir
