// Captures as videos, one per camera.

#pragma once

#include <functional>
#include <string>
#include <vector>

#include "colmap_ext/frames/capture_images.h"
#include "src/sensor/camera_naming.h"

namespace mfir {

struct CaptureVideo {
  std::string camera;  // canonical
  std::string name;    // of its images: "cam00"
  std::string path;
  // Frame k of the capture is frame k + offset of the video.
  int offset = 0;
};

// Whether the folder has video files, and no image file at any depth.
bool HasVideosOnly(const std::string& path);

// The videos in `path` whose names, or folders, are cameras of RIG. Offsets are
// read from lines "CAMERA OFFSET" of `offset_list_path`, if that is not empty.
// Throws InputError: no such video, two of one camera, a bad line of the list.
std::vector<CaptureVideo> FindCaptureVideos(
    const std::string& path,
    const std::vector<std::string>& rig_cameras,
    const CameraNaming& naming,
    const std::string& offset_list_path);

// Names of the frames, six digits each: those of the list, or all that two
// videos have by the lengths that they tell. Throws InputError.
std::vector<std::string> ListVideoFrames(
    const std::vector<CaptureVideo>& videos,
    const std::string& frame_list_path);

// Decodes these frames, each video from its begin (jumps are not exact in all
// codecs), to OUTPUT/FRAME/images/NAME.png. Frames are counted, whatever their
// times. Images are named relative to OUTPUT/FRAME; a frame that a video does
// not have is missing. Calls `log` with a line per video. Throws InputError for
// a video that cannot be opened, OutputError.
std::vector<CaptureFrame> DecodeVideos(
    const std::vector<CaptureVideo>& videos,
    const std::vector<std::string>& frames,
    const std::string& output_path,
    int num_threads,
    const std::function<void(const std::string&)>& log);

}  // namespace mfir
