// Images of a synthetic surface.

#pragma once

#include <cstdint>
#include <vector>

#include "src/scene/scene.h"
#include "src/simulation/synthetic_surface.h"
#include "src/util/random.h"

namespace mfir {

// 8-bit grey image, row-major, top row first.
struct GreyImage {
  size_t width = 0;
  size_t height = 0;
  std::vector<uint8_t> pixels;  // width * height
};

// Image of `surface` as `camera` (cam_from_world and the lens) sees it, in
// front of a flat background.
//
//   blur_px      sigma of the optical blur, on top of the pixel's own area.
//   noise_grey   sigma of the sensor noise, grey levels; drawn from `random`.
GreyImage RenderImage(const SyntheticSurface& surface,
                      const RigCamera& camera,
                      double blur_px,
                      double noise_grey,
                      Random* random);

}  // namespace mfir
