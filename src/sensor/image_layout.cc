#include "src/sensor/image_layout.h"

#include <algorithm>
#include <map>
#include <set>

#include "src/sensor/image_name.h"
#include "src/util/errors.h"

namespace mfir {
namespace {

constexpr const char* kFrameRegexOption = "frame_name_regex";
constexpr const char* kFlatSeparators = "_-.";

class LayoutFinder {
 public:
  LayoutFinder(const std::vector<std::string>& paths,
               const std::vector<std::string>& rig_cameras,
               const CameraNaming& naming)
      : paths_(paths),
        rig_cameras_(rig_cameras.begin(), rig_cameras.end()),
        naming_(naming) {}

  ImageReading ByFrame() const {
    std::map<std::string, std::vector<std::string>> names_of_frame;
    for (const std::string& path : paths_) {
      const size_t slash = path.find('/');
      if (slash == std::string::npos) continue;
      names_of_frame[path.substr(0, slash)].push_back(path.substr(slash + 1));
    }
    std::vector<LocatedImage> images;
    for (const auto& [frame, names] : names_of_frame) {
      const std::vector<std::string> cameras =
          naming_.OfFrame(frame).Names(names);
      for (size_t i = 0; i < names.size(); ++i) {
        images.push_back({frame + "/" + names[i], frame, cameras[i]});
      }
    }
    return Reading(ImageLayout::kByFrame, std::move(images));
  }

  ImageReading ByCamera() const {
    std::vector<LocatedImage> images;
    for (const std::string& path : paths_) {
      const size_t slash = path.find('/');
      if (slash == std::string::npos) continue;
      const std::string folder = path.substr(0, slash);
      const std::string stem = FileStem(path);
      const std::string rest = WithoutName(stem, folder);
      images.push_back({path,
                        rest.empty() ? stem : rest,
                        naming_.Regex().empty()
                            ? CanonicalCameraName(folder)
                            : naming_.Names({path}).front()});
    }
    return Reading(ImageLayout::kByCamera, std::move(images));
  }

  ImageReading Flat(bool camera_first) const {
    std::vector<LocatedImage> images;
    for (const std::string& path : paths_) {
      if (path.find('/') != std::string::npos) continue;
      const LocatedImage image = FlatImage(path, camera_first);
      if (!image.frame.empty()) images.push_back(image);
    }
    return Reading(camera_first ? ImageLayout::kFlatCameraFirst
                                : ImageLayout::kFlatFrameFirst,
                   std::move(images));
  }

  ImageReading ByRegexes(const NameRegex& frame_regex) const {
    std::vector<LocatedImage> images;
    for (const std::string& path : paths_) {
      LocatedImage image{
          path, frame_regex.Captured(path), naming_.Names({path}).front()};
      if (!image.frame.empty()) images.push_back(std::move(image));
    }
    return Reading(ImageLayout::kByRegexes, std::move(images));
  }

  // How well the reading explains the paths, see FindImageLayout.
  double Score(const ImageReading& reading) const {
    std::set<std::string> cameras;
    size_t num_known = 0;
    for (const LocatedImage& image : reading.images) {
      if (rig_cameras_.count(image.camera) == 0) continue;
      ++num_known;
      cameras.insert(image.camera);
    }
    return static_cast<double>(num_known * cameras.size()) /
           static_cast<double>(std::max<size_t>(rig_cameras_.size(), 1));
  }

 private:
  ImageReading Reading(ImageLayout layout,
                       std::vector<LocatedImage> images) const {
    ImageReading reading{layout, std::move(images), -1};
    for (size_t i = 0; i < reading.images.size(); ++i) {
      if (rig_cameras_.count(reading.images[i].camera) > 0) {
        reading.first_known = static_cast<int>(i);
        break;
      }
    }
    return reading;
  }

  // The camera of RIG that a part of a file name stands for, "" if none.
  std::string KnownCamera(const std::string& part) const {
    const std::string paper_prefix = "camera";
    std::vector<std::string> names = {naming_.CameraName(part)};
    if (part.compare(0, paper_prefix.size(), paper_prefix) == 0) {
      names.push_back(CanonicalCameraName(part.substr(paper_prefix.size())));
    }
    for (const std::string& name : names) {
      if (rig_cameras_.count(name) > 0) return name;
    }
    return "";
  }

  // Of the places to split the name, the one with the longest camera.
  LocatedImage FlatImage(const std::string& path, bool camera_first) const {
    const std::string stem = FileStem(path);
    LocatedImage image{path, "", ""};
    size_t longest = 0;
    for (size_t i = stem.find_first_of(kFlatSeparators); i != std::string::npos;
         i = stem.find_first_of(kFlatSeparators, i + 1)) {
      const std::string left = stem.substr(0, i);
      const std::string right = stem.substr(i + 1);
      const std::string& camera_part = camera_first ? left : right;
      const std::string& frame_part = camera_first ? right : left;
      const std::string camera = KnownCamera(camera_part);
      if (camera.empty() || frame_part.empty()) continue;
      if (camera_part.size() <= longest) continue;
      longest = camera_part.size();
      image.frame = frame_part;
      image.camera = camera;
    }
    return image;
  }

  const std::vector<std::string>& paths_;
  const std::set<std::string> rig_cameras_;
  const CameraNaming& naming_;
};

bool AgreesWith(const NameRegex& frame_regex, const ImageReading& reading) {
  return std::all_of(reading.images.begin(),
                     reading.images.end(),
                     [&](const LocatedImage& image) {
                       const std::string frame =
                           frame_regex.Captured(image.path);
                       return frame.empty() || frame == image.frame;
                     });
}

// A regex that captures the frames of the reading.
std::string RegexFor(ImageLayout layout) {
  switch (layout) {
    case ImageLayout::kByFrame:
      return "^([^/]+)/";
    case ImageLayout::kFlatFrameFirst:
      return "^([^/_.-]+)[_.-]";
    case ImageLayout::kFlatCameraFirst:
      return "[_.-]([^/_.-]+)\\.\\w+$";
    default:
      return "([^/]+)\\.\\w+$";
  }
}

std::string DescribeReading(const ImageReading& reading) {
  const LocatedImage& image = reading.images[reading.first_known];
  return DescribeImageLayout(reading.layout) + " (" + image.path +
         ": camera '" + image.camera + "', frame '" + image.frame + "')";
}

[[noreturn]] void ThrowAmbiguous(const ImageReading& a, const ImageReading& b) {
  throw InputError("The images can be read in two ways: " + DescribeReading(a) +
                   ", or " + DescribeReading(b) +
                   ". Decide with --MultiFrame.frame_name_regex '" +
                   RegexFor(a.layout) + "' for the first, '" +
                   RegexFor(b.layout) + "' for the second.");
}

}  // namespace

std::string DescribeImageLayout(ImageLayout layout) {
  switch (layout) {
    case ImageLayout::kByFrame:
      return "images by frame";
    case ImageLayout::kByCamera:
      return "images by camera";
    case ImageLayout::kFlatCameraFirst:
      return "images in one folder, the camera first";
    case ImageLayout::kFlatFrameFirst:
      return "images in one folder, the frame first";
    case ImageLayout::kByRegexes:
      break;
  }
  return "images by the two regular expressions";
}

ImageReading FindImageLayout(const std::vector<std::string>& paths,
                             const std::vector<std::string>& rig_cameras,
                             const CameraNaming& naming,
                             const std::string& frame_name_regex) {
  const LayoutFinder finder(paths, rig_cameras, naming);
  if (!frame_name_regex.empty() && !naming.Regex().empty()) {
    return finder.ByRegexes(NameRegex(kFrameRegexOption, frame_name_regex));
  }
  std::vector<ImageReading> readings = {finder.ByFrame(),
                                        finder.ByCamera(),
                                        finder.Flat(/*camera_first=*/true),
                                        finder.Flat(/*camera_first=*/false)};
  ImageReading by_frame = readings.front();
  const auto remove_if = [&readings](const auto& predicate) {
    readings.erase(std::remove_if(readings.begin(), readings.end(), predicate),
                   readings.end());
  };
  remove_if(
      [](const ImageReading& reading) { return reading.first_known < 0; });
  if (readings.empty()) return by_frame;
  if (!frame_name_regex.empty()) {
    const NameRegex frame_regex(kFrameRegexOption, frame_name_regex);
    remove_if([&](const ImageReading& reading) {
      return !AgreesWith(frame_regex, reading);
    });
    if (readings.empty()) {
      throw InputError(
          "--MultiFrame.frame_name_regex '" + frame_name_regex +
          "' agrees with no layout of the images that names cameras of RIG. "
          "Correct it, or give --MultiFrame.camera_name_regex as well: both "
          "are searched in the paths, such as " +
          paths.front() + ".");
    }
  }
  std::stable_sort(readings.begin(),
                   readings.end(),
                   [&](const ImageReading& a, const ImageReading& b) {
                     return finder.Score(a) > finder.Score(b);
                   });
  if (readings.size() > 1 &&
      2.0 * finder.Score(readings[1]) > finder.Score(readings[0])) {
    ThrowAmbiguous(readings[0], readings[1]);
  }
  return readings.front();
}

}  // namespace mfir
