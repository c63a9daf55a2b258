// frames.bin of COLMAP 4, written without COLMAP.

#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace mfir {

template <typename T>
void AppendBytes(const T& value, std::string* bytes) {
  bytes->append(reinterpret_cast<const char*>(&value), sizeof(value));
}

// Frames 1, 2, ... with these images, each of the camera that has its id.
inline std::string FramesFile(
    const std::vector<std::vector<uint32_t>>& image_ids_of_frames) {
  std::string bytes;
  AppendBytes<uint64_t>(image_ids_of_frames.size(), &bytes);
  uint32_t frame_id = 0;
  for (const std::vector<uint32_t>& image_ids : image_ids_of_frames) {
    AppendBytes<uint32_t>(++frame_id, &bytes);
    AppendBytes<uint32_t>(1, &bytes);  // rig
    for (const double value : {1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0}) {
      AppendBytes(value, &bytes);
    }
    AppendBytes<uint32_t>(static_cast<uint32_t>(image_ids.size()), &bytes);
    for (const uint32_t image_id : image_ids) {
      AppendBytes<int32_t>(0, &bytes);  // a camera
      AppendBytes<uint32_t>(image_id, &bytes);
      AppendBytes<uint64_t>(image_id, &bytes);
    }
  }
  return bytes;
}

}  // namespace mfir
