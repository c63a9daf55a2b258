// SIFT keypoints and descriptors: those of VLFeat (as COLMAP calls it), several
// times faster.

#pragma once

#include <cstdint>
#include <vector>

#include "src/feature/scale_space.h"

namespace mfir {

// Names, meaning and defaults of COLMAP's SiftExtractionOptions.
struct SiftOptions {
  int max_num_features = 8192;
  int first_octave = -1;
  int num_octaves = 4;
  int octave_resolution = 3;
  double peak_threshold = 0.02 / 3.0;
  double edge_threshold = 10.0;
  int max_num_orientations = 2;
  bool upright = false;
  // Descriptors: square roots of L1-normalised ones, or L2-normalised.
  bool root = true;
};

struct SiftKeypoint {
  // Pixels; the centre of the top-left pixel is (0.5, 0.5).
  float x = 0.0f;
  float y = 0.0f;
  float sigma = 0.0f;        // pixels
  float orientation = 0.0f;  // radians, from the x towards the y axis (down)
};

struct SiftFeatures {
  std::vector<SiftKeypoint> keypoints;
  // 128 bytes each: 512 times the descriptor, 255 at most.
  std::vector<uint8_t> descriptors;
};

// Features of an image with values in [0, 1], ordered by octave, level, row and
// column. As in COLMAP, of the levels of the scale space the coarsest are kept
// whose keypoints reach max_num_features.
SiftFeatures ExtractSift(const SiftOptions& options, const FloatImage& image);

}  // namespace mfir
