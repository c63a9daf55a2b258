#include "colmap_ext/frames/capture_videos.h"

#include <algorithm>
#include <cctype>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <mutex>
#include <set>
#include <system_error>

#include <opencv2/imgcodecs.hpp>
#include <opencv2/videoio.hpp>

#include "colmap_ext/host/image_file.h"
#include "colmap_ext/host/util.h"
#include "colmap_ext/io/input_file.h"
#include "colmap_ext/io/quiet_opencv.h"
#include "src/parallel/parallel_for.h"
#include "src/util/errors.h"
#include "src/util/parse_number.h"

namespace mfir {
namespace {

namespace fs = std::filesystem;

constexpr int kMaxNumFrames = 1000000;  // six digits

bool IsVideoFileName(const fs::path& path) {
  static const std::set<std::string> extensions = {".avi",
                                                   ".m2ts",
                                                   ".m4v",
                                                   ".mkv",
                                                   ".mov",
                                                   ".mp4",
                                                   ".mpeg",
                                                   ".mpg",
                                                   ".mts",
                                                   ".mxf",
                                                   ".ogv",
                                                   ".ts",
                                                   ".webm",
                                                   ".wmv"};
  std::string extension = path.extension().string();
  std::transform(extension.begin(),
                 extension.end(),
                 extension.begin(),
                 [](unsigned char c) { return std::tolower(c); });
  return extensions.count(extension) > 0;
}

std::vector<std::string> ListVideoFiles(const std::string& folder) {
  std::vector<std::string> paths;
  for (const auto& entry : fs::recursive_directory_iterator(
           folder, fs::directory_options::follow_directory_symlink)) {
    if (entry.is_regular_file() && IsVideoFileName(entry.path())) {
      paths.push_back(entry.path().lexically_relative(folder).generic_string());
    }
  }
  std::sort(paths.begin(), paths.end());
  return paths;
}

// Cameras of the videos: by file stem or folder, else by a part of the name.
std::vector<std::string> CameraNames(
    const std::vector<std::string>& paths,
    const std::vector<std::string>& rig_cameras,
    const CameraNaming& naming) {
  const std::vector<std::string> names = naming.Names(paths);
  for (const std::string& name : names) {
    if (std::find(rig_cameras.begin(), rig_cameras.end(), name) !=
        rig_cameras.end()) {
      return names;
    }
  }
  std::map<std::string, std::string> camera_of_path;
  for (const LocatedImage& image :
       FindImageLayout(paths, rig_cameras, naming, "").images) {
    camera_of_path[image.path] = image.camera;
  }
  std::vector<std::string> other_names;
  for (const std::string& path : paths) {
    other_names.push_back(camera_of_path[path]);
  }
  return other_names;
}

void ReadOffsets(const std::string& path, std::vector<CaptureVideo>* videos) {
  if (path.empty()) return;
  for (const ListEntry& entry :
       ReadNameList("--MultiFrame.video_offset_list_path", path)) {
    const size_t end_of_name = entry.name.find_last_of(" \t");
    int offset = 0;
    if (end_of_name == std::string::npos ||
        !ParseNumber(entry.name.substr(end_of_name + 1), &offset) ||
        std::abs(offset) >= kMaxNumFrames) {
      throw InputError(entry.where + "'" + entry.name +
                       "' is not a camera and its offset in frames, such as "
                       "'cam07 -3'.");
    }
    std::string name = entry.name.substr(0, end_of_name);
    host::StringTrim(&name);
    const auto video = std::find_if(
        videos->begin(), videos->end(), [&](const CaptureVideo& other) {
          return other.camera == CanonicalCameraName(name);
        });
    if (video == videos->end()) {
      throw InputError(entry.where + "there is no video of a camera '" + name +
                       "'. Correct or remove the line.");
    }
    video->offset = offset;
  }
}

cv::VideoCapture Open(const CaptureVideo& video) {
  cv::VideoCapture capture(video.path, cv::CAP_FFMPEG);
  if (!capture.isOpened()) capture.open(video.path, cv::CAP_ANY);
  if (!capture.isOpened()) {
    throw InputError(video.path +
                     ": the video cannot be opened. Is it complete, and does "
                     "OpenCV have its codec? Otherwise convert it, or extract "
                     "its images.");
  }
  return capture;
}

std::string FrameName(int idx) { return host::StringPrintf("%06d", idx); }

// Paths of the decoded images by frame.
std::map<std::string, std::string> DecodeVideo(
    const CaptureVideo& video,
    const std::vector<std::string>& frames,
    const std::string& output_path) {
  const QuietOpenCV quiet_opencv;
  cv::VideoCapture capture = Open(video);
  std::map<std::string, std::string> paths;
  int position = 0;  // of the frame that comes next
  cv::Mat image;
  for (const std::string& frame : frames) {  // ascending
    const int wanted = std::stoi(frame) + video.offset;
    if (wanted < 0) continue;
    bool is_there = true;
    for (; is_there && position <= wanted; ++position)
      is_there = capture.grab();
    if (!is_there || !capture.retrieve(image) || image.empty()) break;
    const fs::path folder = fs::path(output_path) / frame / "images";
    std::error_code error;
    fs::create_directories(folder, error);
    const std::string path = (folder / (video.name + ".png")).string();
    bool is_written = false;
    try {
      is_written = cv::imwrite(path, image);
    } catch (const cv::Exception&) {
    }
    if (!is_written) {
      throw OutputError(path + ": cannot write the image. Is the disk full?");
    }
    paths[frame] = path;
  }
  return paths;
}

}  // namespace

bool HasVideosOnly(const std::string& path) {
  std::error_code error;
  if (path.empty() || !fs::is_directory(path, error)) return false;
  bool has_video = false;
  for (const auto& entry : fs::recursive_directory_iterator(
           path, fs::directory_options::follow_directory_symlink)) {
    if (host::IsImageFileName(entry.path().string())) return false;
    has_video = has_video || IsVideoFileName(entry.path());
  }
  return has_video;
}

std::vector<CaptureVideo> FindCaptureVideos(
    const std::string& path,
    const std::vector<std::string>& rig_cameras,
    const CameraNaming& naming,
    const std::string& offset_list_path) {
  const std::vector<std::string> files = ListVideoFiles(path);
  const std::vector<std::string> cameras =
      CameraNames(files, rig_cameras, naming);
  std::vector<CaptureVideo> videos;
  for (size_t i = 0; i < files.size(); ++i) {
    if (std::find(rig_cameras.begin(), rig_cameras.end(), cameras[i]) ==
        rig_cameras.end()) {
      continue;
    }
    for (const CaptureVideo& other : videos) {
      if (other.camera == cameras[i]) {
        throw InputError("--image_path " + path + ": " + files[i] + " and " +
                         other.path + " are both of camera '" + cameras[i] +
                         "'. Give one video per camera.");
      }
    }
    videos.push_back(
        {cameras[i], cameras[i], (fs::path(path) / files[i]).string(), 0});
  }
  if (videos.empty()) {
    throw InputError("--image_path " + path +
                     " has no video of a camera of RIG, but, for example, " +
                     files.front() + " beside camera '" + rig_cameras.front() +
                     "'. Name videos as their cameras, or set "
                     "--MultiFrame.camera_name_regex.");
  }
  ReadOffsets(offset_list_path, &videos);
  return videos;
}

std::vector<std::string> ListVideoFrames(
    const std::vector<CaptureVideo>& videos,
    const std::string& frame_list_path) {
  std::set<std::string> names;
  if (!frame_list_path.empty()) {
    for (const ListEntry& entry :
         ReadNameList("--frame_list_path", frame_list_path)) {
      int idx = 0;
      if (!ParseNumber(entry.name, &idx) || idx < 0 || idx >= kMaxNumFrames) {
        throw InputError(entry.where + "'" + entry.name +
                         "' is not the number of a frame of the videos, which "
                         "count from 0.");
      }
      names.insert(FrameName(idx));
    }
    return {names.begin(), names.end()};
  }
  const QuietOpenCV quiet_opencv;
  std::vector<std::pair<int, int>> ranges;
  for (const CaptureVideo& video : videos) {
    const double length = Open(video).get(cv::CAP_PROP_FRAME_COUNT);
    ranges.emplace_back(
        std::max(0, -video.offset),
        static_cast<int>(std::clamp(length, 0.0, kMaxNumFrames * 1.0)) -
            video.offset);
  }
  std::map<int, int> changes;  // of the number of videos that have a frame
  for (const auto& [begin, end] : ranges) {
    if (begin >= end) continue;
    ++changes[begin];
    --changes[end];
  }
  int num_videos = 0;
  for (auto it = changes.begin(); it != changes.end(); ++it) {
    num_videos += it->second;
    if (num_videos < 2) continue;
    for (int idx = it->first; idx < std::next(it)->first; ++idx) {
      names.insert(FrameName(idx));
    }
  }
  if (names.empty()) {
    throw InputError(
        "The videos have no frame in common, or do not tell their "
        "lengths. Check --MultiFrame.video_offset_list_path, or "
        "give --frame_list_path.");
  }
  return {names.begin(), names.end()};
}

std::vector<CaptureFrame> DecodeVideos(
    const std::vector<CaptureVideo>& videos,
    const std::vector<std::string>& frames,
    const std::string& output_path,
    int num_threads,
    const std::function<void(const std::string&)>& log) {
  std::vector<std::map<std::string, std::string>> paths(videos.size());
  std::mutex mutex;
  ParallelFor(videos.size(), num_threads, [&](size_t i) {
    paths[i] = DecodeVideo(videos[i], frames, output_path);
    const std::lock_guard<std::mutex> lock(mutex);
    log(videos[i].path + ": " + std::to_string(paths[i].size()) + " of " +
        std::to_string(frames.size()) + " frames decoded");
  });
  std::vector<CaptureFrame> result;
  for (const std::string& frame : frames) {
    result.push_back({frame, {}});
    for (size_t i = 0; i < videos.size(); ++i) {
      const auto path = paths[i].find(frame);
      if (path == paths[i].end()) continue;
      result.back().images.push_back({"images/" + videos[i].name + ".png",
                                      videos[i].camera,
                                      path->second});
    }
  }
  return result;
}

}  // namespace mfir
