// Orientations and descriptors of SIFT (Lowe 2004), with the conventions of
// VLFeat.

#pragma once

#include <array>
#include <vector>

#include "src/feature/descriptor_products.h"
#include "src/feature/scale_space.h"

namespace mfir {

// In the pixels of `image`, counted from the centre of the first: of the level
// of the scale space that is nearest to `sigma`.
struct SiftFrame {
  double x = 0.0;
  double y = 0.0;
  double sigma = 0.0;
};

// Angles (radians, from the x axis towards the y axis, which points down) of
// the gradients' main directions around the keypoint, at most four.
std::vector<double> SiftOrientations(const FloatImage& image,
                                     const SiftFrame& frame);

// Histogram of gradient directions relative to `orientation`, of length 1
// (0 without any gradient): element 8 (4 row + column) + direction, directions
// counted against the sense of `orientation`, as in Lowe's program.
std::array<float, kSiftDescriptorSize> SiftDescriptor(const FloatImage& image,
                                                      const SiftFrame& frame,
                                                      double orientation);

}  // namespace mfir
