#include "colmap_ext/feature/image_folder.h"

#include <filesystem>

#include "colmap_ext/host/util.h"
#include "src/sensor/camera_naming.h"
#include "src/sensor/image_name.h"
#include "src/util/errors.h"

namespace mfir {

namespace fs = std::filesystem;

std::string ImageFolder::Find(const DenseFeatureRequest& request) const {
  for (const fs::path& path :
       {fs::path(path_) / request.frame_name / request.image_name,
        fs::path(path_) / request.image_name}) {
    std::error_code error;
    if (fs::is_regular_file(path, error)) return path.string();
  }
  std::error_code error;
  // By frame: the same names may mean something else there.
  if (fs::is_directory(fs::path(path_) / request.frame_name, error)) return "";
  std::call_once(index_->once, [this]() { MakeIndex(); });
  const auto it = index_->paths.find({request.camera_name, request.frame_name});
  return it == index_->paths.end() ? "" : it->second;
}

// Which part of a name is the camera does not matter here: both ways to split
// it are entered, and cameras are asked for by their names in RIG.
void ImageFolder::MakeIndex() const {
  const auto add = [this](const std::string& camera,
                          const std::string& frame,
                          const fs::path& path) {
    index_->paths.emplace(std::pair(CanonicalCameraName(camera), frame),
                          path.string());
  };
  const auto visit_images = [](const fs::path& folder, const auto& visit) {
    std::error_code error;
    for (const auto& entry : fs::directory_iterator(folder, error)) {
      if (entry.is_regular_file(error) &&
          host::IsImageFileName(entry.path().string())) {
        visit(entry.path(), FileStem(entry.path().filename().string()));
      }
    }
  };
  visit_images(path_, [&](const fs::path& path, const std::string& stem) {
    for (size_t i = stem.find_first_of("_-."); i != std::string::npos;
         i = stem.find_first_of("_-.", i + 1)) {
      add(stem.substr(0, i), stem.substr(i + 1), path);
      add(stem.substr(i + 1), stem.substr(0, i), path);
    }
  });
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(path_, error)) {
    if (!entry.is_directory(error)) continue;
    const std::string camera = entry.path().filename().string();
    visit_images(entry.path(),
                 [&](const fs::path& path, const std::string& stem) {
                   const std::string rest = WithoutName(stem, camera);
                   add(camera, rest.empty() ? stem : rest, path);
                 });
  }
}

bool ImageFolder::Read(const DenseFeatureRequest& request,
                       bool as_rgb,
                       host::Bitmap* bitmap) const {
  const std::string path = Find(request);
  if (path.empty()) {
    return false;
  }
  *bitmap = ReadImage(path, request.width, request.height, as_rgb);
  return true;
}

host::Bitmap ReadImage(const std::string& path,
                       int width,
                       int height,
                       bool as_rgb) {
  host::Bitmap bitmap;
  if (!bitmap.Read(path, as_rgb)) {
    throw InputError(path +
                     ": not a readable image. Replace the file, or remove it "
                     "to go without the image.");
  }
  if (bitmap.Width() != width || bitmap.Height() != height) {
    throw InputError(host::StringPrintf(
        "%s has %d x %d pixels, but its camera has %d x %d. Give the images "
        "that the models were made from (--image_path).",
        path.c_str(),
        bitmap.Width(),
        bitmap.Height(),
        width,
        height));
  }
  return bitmap;
}

}  // namespace mfir
