#include "src/patches/patch_alignment.h"

#include <cmath>

#include "src/util/target_clones.h"

namespace mfir {
namespace {

MFIR_TARGET_CLONES
bool MakeTemplateOnCpu(const PatchDisc& disc,
                       const SplineView& image,
                       const double* xy,
                       PatchTemplate* patch) {
  return MakePatchTemplate(SerialGroup(), disc, image, xy, patch);
}

MFIR_TARGET_CLONES
void FitOnCpu(const PatchDisc& disc,
              const PatchTemplate& patch,
              const SplineView& image,
              const PatchWarp& warp,
              PatchFit* fit) {
  float samples[kPatchStride];
  FitPatch(SerialGroup(), disc, patch, image, warp, samples, fit);
}

MFIR_TARGET_CLONES
void AlignOnCpu(const PatchDisc& disc,
                const PatchTemplate& patch,
                const SplineView& image,
                PatchWarp* warp,
                PatchAlignment* result) {
  float samples[kPatchStride];
  *result = AlignPatch(SerialGroup(), disc, patch, image, samples, warp);
}

MFIR_TARGET_CLONES
float SearchOnCpu(const PatchDisc& disc,
                  const PatchTemplate& patch,
                  const SplineView& image,
                  PatchWarp* warp) {
  float window[kPatchWindowSize];
  float scores[kNumPatchShifts];
  return SearchPatch(SerialGroup(), disc, patch, image, window, scores, warp);
}

}  // namespace

const PatchDisc& GetPatchDisc() {
  static const PatchDisc disc = MakePatchDisc();
  return disc;
}

bool MakePatchTemplate(const SplineImage& image,
                       const Eigen::Vector2d& xy,
                       PatchTemplate* patch) {
  return MakeTemplateOnCpu(GetPatchDisc(), image.View(), xy.data(), patch);
}

bool FitPatch(const PatchTemplate& patch,
              const SplineImage& image,
              const PatchWarp& warp,
              PatchFit* fit) {
  if (!IsPatchInside(image.View(), warp, kPatchRadius)) return false;
  FitOnCpu(GetPatchDisc(), patch, image.View(), warp, fit);
  return fit->coefficients[kGainIdx] > 0.0f;
}

PatchAlignment AlignPatch(const PatchTemplate& patch,
                          const SplineImage& image,
                          PatchWarp* warp) {
  PatchAlignment result;
  AlignOnCpu(GetPatchDisc(), patch, image.View(), warp, &result);
  return result;
}

float SearchPatch(const PatchTemplate& patch,
                  const SplineImage& image,
                  PatchWarp* warp) {
  return SearchOnCpu(GetPatchDisc(), patch, image.View(), warp);
}

double PatchStd(const PatchAlignment& alignment) {
  const float* c = alignment.covariance;
  const double mean = 0.5 * (c[0] + c[2]);
  const double difference = 0.5 * (c[0] - c[2]);
  return std::sqrt(mean + std::hypot(difference, static_cast<double>(c[1])));
}

}  // namespace mfir
