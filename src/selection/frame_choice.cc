#include "src/selection/frame_choice.h"

namespace mfir {

std::vector<size_t> ChooseFrames(size_t num_frames, size_t max_num_frames) {
  const size_t num_parts = max_num_frames == 0 || max_num_frames > num_frames
                               ? num_frames
                               : max_num_frames;
  std::vector<size_t> chosen;
  for (size_t part = 0; part < num_parts; ++part) {
    chosen.push_back((2 * part + 1) * num_frames / (2 * num_parts));
  }
  return chosen;
}

}  // namespace mfir
