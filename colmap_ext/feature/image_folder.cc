#include "colmap_ext/feature/image_folder.h"

#include <filesystem>

#include "colmap_ext/host/util.h"
#include "src/util/errors.h"

namespace mfir {

namespace fs = std::filesystem;

std::string ImageFolder::Find(const std::string& frame_name,
                              const std::string& image_name) const {
  for (const fs::path& path : {fs::path(path_) / frame_name / image_name,
                               fs::path(path_) / image_name}) {
    std::error_code error;
    if (fs::is_regular_file(path, error)) {
      return path.string();
    }
  }
  return "";
}

bool ImageFolder::Read(const DenseFeatureRequest& request,
                       bool as_rgb,
                       host::Bitmap* bitmap) const {
  const std::string path = Find(request.frame_name, request.image_name);
  if (path.empty()) {
    return false;
  }
  if (!bitmap->Read(path, as_rgb)) {
    throw InputError(path +
                     ": not a readable image. Replace the file, or remove it "
                     "to go without its dense features.");
  }
  if (bitmap->Width() != request.width || bitmap->Height() != request.height) {
    throw InputError(host::StringPrintf(
        "%s has %d x %d pixels, but its camera in frame '%s' has %d x %d. Give "
        "the images that the models were made from (--image_path).",
        path.c_str(),
        bitmap->Width(),
        bitmap->Height(),
        request.frame_name.c_str(),
        request.width,
        request.height));
  }
  return true;
}

}  // namespace mfir
