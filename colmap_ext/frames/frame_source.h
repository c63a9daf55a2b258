// Where the frames of a capture come from: a folder with one sub-folder per
// frame, or one model that holds them all.

#pragma once

#include <memory>
#include <string>
#include <vector>

#include "colmap_ext/frames/frames.h"

namespace mfir {

class FrameSource {
 public:
  virtual ~FrameSource() = default;

  // Sorted.
  virtual const std::vector<std::string>& Names() const = 0;

  // The frame of that index in Names(), with its model as it is; without one,
  // with a reason to skip it. Throws InputError for an unreadable model.
  virtual FrameModel Read(size_t idx) const = 0;
};

// In `frames_path`, only those of `frame_list_path` (one name per line) if not
// empty. If the folder has the files of a model itself, that model has all
// frames: those that COLMAP 4's file of frames says, else by the names of the
// images (frame_naming.h), for which `frame_name_regex` always decides if given
// and `cameras` are those of RIG. Images of no frame are named on stderr.
// Throws InputError for what cannot be read, without any frame, or for a frame
// of the list that does not exist.
std::unique_ptr<FrameSource> OpenFrames(
    const std::string& frames_path,
    const std::string& frame_list_path,
    const std::string& frame_name_regex,
    const std::vector<KnownCamera>& cameras);

}  // namespace mfir
