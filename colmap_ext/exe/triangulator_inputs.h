// What the triangulator reads before it starts: cameras, images, pairs.

#pragma once

#include <string>
#include <utility>
#include <vector>

#include "colmap_ext/frames/frame_database.h"
#include "colmap_ext/options/triangulator_options.h"
#include "src/scene/scene.h"
#include "src/sensor/camera_naming.h"

namespace mfir {

struct InputFrame {
  std::string name;
  std::vector<FrameImageFile> files;
  std::vector<std::string> warnings;
  std::string failure;  // empty: none so far
};

struct TriangulatorInputs {
  CameraNaming naming;
  std::vector<RigCamera> cameras;  // in the order of RIG
  std::vector<InputFrame> frames;
  std::vector<std::pair<size_t, size_t>> pairs;  // of cameras
  std::string fingerprint;  // of all that decides on the result but images
};

// Finds the images of all frames and their cameras, with the intrinsics to
// start from, and selects the pairs of cameras to match. What is wrong with a
// single frame is its `failure`. Throws InputError: unreadable RIG, no frames,
// cameras without intrinsics, fewer than two cameras with images.
TriangulatorInputs ReadTriangulatorInputs(const TriangulatorOptions& options,
                                          const OptionParser& parser);

}  // namespace mfir
