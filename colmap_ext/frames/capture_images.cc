#include "colmap_ext/frames/capture_images.h"

#include <algorithm>
#include <filesystem>
#include <map>
#include <set>
#include <system_error>

#include "colmap_ext/frames/frames.h"
#include "colmap_ext/host/image_file.h"
#include "colmap_ext/io/input_file.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

// Relative to the folder, sorted.
std::vector<std::string> ListImageFiles(const std::string& folder) {
  std::error_code error;
  if (!fs::is_directory(folder, error)) {
    throw InputError("--image_path " + folder +
                     " is not a folder. Give the folder of the images.");
  }
  std::vector<std::string> paths;
  for (const auto& entry : fs::recursive_directory_iterator(
           folder, fs::directory_options::follow_directory_symlink)) {
    if (host::IsImageFileName(entry.path().string()) &&
        entry.is_regular_file()) {
      paths.push_back(entry.path().lexically_relative(folder).generic_string());
    }
  }
  std::sort(paths.begin(), paths.end());
  return paths;
}

// The frames of the list in the order of their names; all if there is no list.
std::vector<CaptureFrame> SelectFrames(
    const std::string& image_path,
    const std::string& frame_list_path,
    std::map<std::string, CaptureFrame> frames) {
  std::vector<CaptureFrame> selected;
  std::set<std::string> listed;
  if (!frame_list_path.empty()) {
    for (const ListEntry& entry :
         ReadNameList("--frame_list_path", frame_list_path)) {
      if (frames.count(entry.name) == 0) {
        throw InputError(entry.where + "there is no frame '" + entry.name +
                         "' in " + image_path + ", whose first frame is '" +
                         frames.begin()->first + "'.");
      }
      listed.insert(entry.name);
    }
  }
  for (auto& [name, frame] : frames) {
    if (frame_list_path.empty() || listed.count(name) > 0) {
      selected.push_back(std::move(frame));
    }
  }
  return selected;
}

CaptureImages ByFrame(const std::string& image_path,
                      const std::string& frame_list_path,
                      const ImageReading& reading) {
  CaptureImages result;
  std::map<std::string, size_t> frame_idxs;
  for (const std::string& name :
       ListFrames("image_path", image_path, frame_list_path)) {
    frame_idxs[name] = result.frames.size();
    result.frames.push_back({name, {}});
  }
  for (const LocatedImage& image : reading.images) {
    const auto it = frame_idxs.find(image.frame);
    if (it == frame_idxs.end()) continue;
    result.frames[it->second].images.push_back(
        {image.path.substr(image.frame.size() + 1),
         image.camera,
         (fs::path(image_path) / image.path).string()});
  }
  return result;
}

CaptureImages InOtherLayout(const std::string& image_path,
                            const std::string& frame_list_path,
                            const ImageReading& reading) {
  std::map<std::string, CaptureFrame> frames;
  for (const LocatedImage& image : reading.images) {
    CaptureFrame& frame = frames[image.frame];
    frame.name = image.frame;
    frame.images.push_back({image.path,
                            image.camera,
                            (fs::path(image_path) / image.path).string()});
  }
  return {"", SelectFrames(image_path, frame_list_path, std::move(frames)), {}};
}

}  // namespace

CaptureImages FindCaptureImages(const std::string& image_path,
                                const std::string& frame_list_path,
                                const std::vector<std::string>& rig_cameras,
                                const CameraNaming& naming,
                                const std::string& frame_name_regex) {
  const std::vector<std::string> paths = ListImageFiles(image_path);
  const ImageReading reading =
      FindImageLayout(paths, rig_cameras, naming, frame_name_regex);
  CaptureImages result =
      reading.layout == ImageLayout::kByFrame
          ? ByFrame(image_path, frame_list_path, reading)
          : InOtherLayout(image_path, frame_list_path, reading);
  std::set<std::string> in_frames;
  for (const LocatedImage& image : reading.images) in_frames.insert(image.path);
  for (const std::string& path : paths) {
    if (in_frames.count(path) == 0) result.left_out.push_back(path);
  }
  if (reading.first_known >= 0) {
    result.description = DescribeImageLayout(reading.layout) + ": " +
                         reading.images[reading.first_known].path;
  }
  return result;
}

}  // namespace mfir
