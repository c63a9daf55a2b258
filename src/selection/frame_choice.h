// Some of the frames of a long capture.

#pragma once

#include <cstddef>
#include <vector>

namespace mfir {

// Indices of `max_num_frames` of `num_frames` frames, ascending: the middle
// ones of as many equal parts of the capture. All if there are not more, or if
// `max_num_frames` is 0.
std::vector<size_t> ChooseFrames(size_t num_frames, size_t max_num_frames);

}  // namespace mfir
