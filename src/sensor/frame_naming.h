// From image names to frames, for a model that holds many.

#pragma once

#include <set>
#include <string>
#include <vector>

namespace mfir {

// Frames of the images of one model, in order: names that can be folders.
//
// With a regular expression (one capture group, searched in the image name):
// the captured text, "" for an image that does not match (the caller reports
// it). Without one, the first rule that all images fit:
//   1. the path after the first folder, if all first folders and not all file
//      stems are in `camera_names` ("cam07/000123.jpg" -> "000123"),
//   2. the first folder ("000123/cam07.jpg" -> "000123"),
//   3. the paper's "camera\d+_frame(\d+)",
//   4. all images are of one frame, "frame".
// `camera_names` are canonical (camera_naming.h). Throws UsageError when
// `regex` is not valid or has not exactly one group.
std::vector<std::string> FrameNames(const std::vector<std::string>& image_names,
                                    const std::set<std::string>& camera_names,
                                    const std::string& regex = "");

// Names for groups of images that are known to be frames: what the images of a
// frame share and those of the others have not, by the same rules; else
// "frame1", "frame2", ... in order.
std::vector<std::string> NamesOfFrames(
    const std::vector<std::vector<std::string>>& image_names_of_frames);

}  // namespace mfir
