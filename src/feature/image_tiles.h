// Division of large images into overlapping tiles.

#pragma once

#include <cstddef>
#include <vector>

namespace mfir {

// Along one axis of an image, in pixels: tile k is [begins[k], begins[k] +
// size), and serves what is centred in [cores[k], cores[k + 1]). Around its
// core each tile has at least the margin, or reaches the end of the image. The
// last one may end up to alignment - 1 pixels beyond the image.
struct TilesAlongAxis {
  int size = 0;
  std::vector<int> begins;
  std::vector<int> cores;

  size_t TileOf(double coordinate) const;
};

// The fewest tiles of at most `max_size`, or of just that size if `fixed_size`;
// their size and positions are multiples of `alignment`, as is max_size. Throws
// UsageError if the margin leaves no room.
TilesAlongAxis PlanTiles(int image_size,
                         int max_size,
                         int margin,
                         int alignment,
                         bool fixed_size = false);

}  // namespace mfir
