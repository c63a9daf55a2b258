#include "src/feature/image_tiles.h"

#include <algorithm>
#include <cstdint>
#include <string>

#include "src/util/errors.h"

namespace mfir {
namespace {

int RoundUp(int value, int alignment) {
  return (value + alignment - 1) / alignment * alignment;
}

TilesAlongAxis EqualTiles(int image_size,
                          int num_tiles,
                          int margin,
                          int alignment) {
  TilesAlongAxis tiles;
  for (int k = 0; k <= num_tiles; ++k) {
    tiles.cores.push_back(
        static_cast<int>(static_cast<int64_t>(image_size) * k / num_tiles));
  }
  for (int k = 0; k < num_tiles; ++k) {
    const int begin = std::max(0, tiles.cores[k] - margin);
    const int end = std::min(image_size, tiles.cores[k + 1] + margin);
    tiles.begins.push_back(begin / alignment * alignment);
    tiles.size =
        std::max(tiles.size, RoundUp(end - tiles.begins.back(), alignment));
  }
  return tiles;
}

}  // namespace

size_t TilesAlongAxis::TileOf(double coordinate) const {
  size_t k = 0;
  while (k + 1 < begins.size() && coordinate >= cores[k + 1]) ++k;
  return k;
}

TilesAlongAxis PlanTiles(
    int image_size, int max_size, int margin, int alignment, bool fixed_size) {
  const int step = max_size - 2 * margin - alignment;
  if (image_size > max_size && step <= 0) {
    throw UsageError(
        "--MultiFrame.onnx_tile_size " + std::to_string(max_size) +
        " has no room for onnx_tile_overlap on both sides of a patch, which "
        "needs more than " +
        std::to_string(2 * margin + alignment) +
        " px. Raise the former or lower the latter.");
  }
  TilesAlongAxis tiles;
  for (int num_tiles = 1; tiles.begins.empty() || tiles.size > max_size;
       ++num_tiles) {
    tiles = EqualTiles(image_size, num_tiles, margin, alignment);
  }
  // All tiles have one size, for which the network is set up once.
  if (fixed_size) tiles.size = max_size;
  const int last = std::max(0, RoundUp(image_size, alignment) - tiles.size);
  for (int& begin : tiles.begins) begin = std::min(begin, last);
  return tiles;
}

}  // namespace mfir
