// Alignment of single image patches on the CPU, see patch_alignment_kernels.h.

#pragma once

#include <Eigen/Core>

#include "src/patches/patch_alignment_kernels.h"
#include "src/patches/spline_image.h"

namespace mfir {

// The samples of all patches.
const PatchDisc& GetPatchDisc();

// Prepares the patch around `xy`. False where it leaves the image or has too
// little texture to determine an affine map.
bool MakePatchTemplate(const SplineImage& image,
                       const Eigen::Vector2d& xy,
                       PatchTemplate* patch);

// Fit of the patch that the warp shows, without moving it. False where it
// leaves the image or the gain is not positive.
bool FitPatch(const PatchTemplate& patch,
              const SplineImage& image,
              const PatchWarp& warp,
              PatchFit* fit);

// Moves the warp to where the image fits the reference patch best.
PatchAlignment AlignPatch(const PatchTemplate& patch,
                          const SplineImage& image,
                          PatchWarp* warp);

// Moves the warp to the best of the whole shifts around it and returns the ZNCC
// there, or -1 where the image ends too near.
float SearchPatch(const PatchTemplate& patch,
                  const SplineImage& image,
                  PatchWarp* warp);

// Largest standard deviation of the position over all directions, px of the
// other image.
double PatchStd(const PatchAlignment& alignment);

}  // namespace mfir
