// Small image patches that are found again in another view: the same functions
// are called on the CPU (patch_alignment.cc) and by the CUDA kernel
// (cuda/patch_alignment_gpu.cu).
//
// The reference patch R is sampled on a disc of offsets u (pixels of the
// reference image) around its keypoint, the other image T at the positions
// W(u) = centre + A u + q(u), where q is the quadratic part of the warp. Where
// W is nearly right,
//   T(W(u)) ~ gain R(u + d(u)) + offset,   d(u) = d0 + D u,
// which is linear in 8 numbers: gain d0, gain D, gain and offset. The basis of
// that fit depends on the reference patch alone, so that it is a product with a
// fixed 8 x N matrix. It tells how wrong the shape of W is (patch_slope.h). An
// alignment (AlignPatch) only moves the centre.
//
// Images are given as coefficients of a cubic B-spline: no blur, and a smooth
// derivative. Image coordinates are COLMAP's: the centre of the top-left pixel
// is (0.5, 0.5).
//
// A group of threads (thread_group.h) works on one patch; it needs Rank, Size,
// Sync and Sum.

#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>
#include <type_traits>

#include "src/parallel/float_array.h"
#include "src/parallel/thread_group.h"

namespace mfir {

constexpr int kPatchRadius = 5;  // px of the reference image

constexpr int CountDiscPixels(int radius) {
  int count = 0;
  for (int v = -radius; v <= radius; ++v) {
    for (int u = -radius; u <= radius; ++u) {
      count += u * u + v * v <= radius * radius ? 1 : 0;
    }
  }
  return count;
}

constexpr int kNumPatchSamples = CountDiscPixels(kPatchRadius);
// Rows of the arrays below; the rest is zero, so that loops vectorize.
constexpr int kPatchStride = (kNumPatchSamples + 15) / 16 * 16;

// Coefficients of the fit: d/dx, d/dy (times 1, u / radius, v / radius in
// turn), the patch, and a constant. In the order of the basis functions R_x,
// R_y, R_x u, R_x v, R_y u, R_y v, R, 1.
constexpr int kNumPatchBasis = 8;
constexpr int kGainIdx = 6;
constexpr int kOffsetIdx = 7;

// Offsets of the samples, pixels of the reference image.
struct PatchDisc {
  float u[kPatchStride];
  float v[kPatchStride];
};

inline PatchDisc MakePatchDisc() {
  PatchDisc disc = {};
  int i = 0;
  for (int v = -kPatchRadius; v <= kPatchRadius; ++v) {
    for (int u = -kPatchRadius; u <= kPatchRadius; ++u) {
      if (u * u + v * v > kPatchRadius * kPatchRadius) continue;
      disc.u[i] = static_cast<float>(u);
      disc.v[i] = static_cast<float>(v);
      ++i;
    }
  }
  return disc;
}

// Coefficients of a cubic B-spline, rows of `width`.
struct SplineView {
  const float* coefficients;
  int width;
  int height;
};

// Position of offset (u, v): centre + A (u, v) + q, where
// q_x = quadratic[0] u u + quadratic[1] u v + quadratic[2] v v
// and q_y the same with the other three.
struct PatchWarp {
  double center[2];
  float affine[4];  // row-major
  float quadratic[6];
};

// The reference patch, prepared for fits: R has mean 0 and rms 1.
struct PatchTemplate {
  float basis[kNumPatchBasis][kPatchStride];
  // (B B^T)^-1 B, for the coefficients of the best fit.
  float projector[kNumPatchBasis][kPatchStride];
  float inverse[kNumPatchBasis * kNumPatchBasis];  // (B B^T)^-1
  // R_x and R_y without what R and 1 explain of them, and the inverse of their
  // products: xx, xy, yy.
  float gradient[2][kPatchStride];
  float gradient_inverse[3];
  float contrast;  // rms of the patch before, grey levels
};

// How well a sampled patch fits the reference patch.
struct PatchFit {
  float coefficients[kNumPatchBasis];
  float zncc;  // of the patch as it is sampled
  // Mean square of what the fit leaves, relative to the gain: the reference
  // patch has the variance 1.
  float noise_variance;
};

enum class PatchEnd {
  kConverged,
  kOutside,     // leaves the image
  kDissimilar,  // no positive gain
  kDiverged     // does not stop, or moves too far
};

struct PatchAlignment {
  PatchEnd end;
  float zncc;
  // Of the position: xx, xy, yy (px^2 of the other image), as follows from what
  // the fit leaves if pixels err independently.
  float covariance[3];
};

constexpr int kMaxNumPatchIterations = 30;
constexpr float kPatchStepTolerance = 0.001f;  // px of the reference image
constexpr float kMaxPatchStep = 1.0f;          // px of the reference image
constexpr float kMaxPatchShift = 4.0f;         // px

// -----------------------------------------------------------------------------
// Spline
// -----------------------------------------------------------------------------

// Weights of nodes -1, 0, 1, 2 at position t in [0, 1] from node 0.
MFIR_HOST_DEVICE void CubicSplineWeights(float t, float* w) {
  const float s = 1.0f - t;
  w[0] = s * s * s * (1.0f / 6.0f);
  w[1] = 2.0f / 3.0f - 0.5f * t * t * (1.0f + s);
  w[2] = 2.0f / 3.0f - 0.5f * s * s * (1.0f + t);
  w[3] = t * t * t * (1.0f / 6.0f);
}

MFIR_HOST_DEVICE void CubicSplineDerivatives(float t, float* d) {
  const float s = 1.0f - t;
  d[0] = -0.5f * s * s;
  d[1] = t * (1.5f * t - 2.0f);
  d[2] = -s * (1.5f * s - 2.0f);
  d[3] = 0.5f * t * t;
}

// sum_ij wy[j] wx[i] c(i, j) of the 4 x 4 coefficients from `corner`.
MFIR_HOST_DEVICE float WeightedSum(const float* corner,
                                   int width,
                                   const float* wx,
                                   const float* wy) {
  Float4 columns = {};
  for (int j = 0; j < 4; ++j) {
    Float4 row;
    memcpy(&row, corner + j * width, sizeof(row));
    columns += row * wy[j];
  }
  return (wx[0] * columns[0] + wx[1] * columns[1]) +
         (wx[2] * columns[2] + wx[3] * columns[3]);
}

// -----------------------------------------------------------------------------
// Sampling
// -----------------------------------------------------------------------------

// Whether all offsets up to `reach` in u and v have the 4 x 4 coefficients
// around them.
MFIR_HOST_DEVICE bool IsPatchInside(const SplineView& image,
                                    const PatchWarp& warp,
                                    float reach) {
  const float* a = warp.affine;
  const float* q = warp.quadratic;
  const float extent_x =
      reach * (fabsf(a[0]) + fabsf(a[1])) +
      reach * reach * (fabsf(q[0]) + fabsf(q[1]) + fabsf(q[2]));
  const float extent_y =
      reach * (fabsf(a[2]) + fabsf(a[3])) +
      reach * reach * (fabsf(q[3]) + fabsf(q[4]) + fabsf(q[5]));
  // Negated, so that NaN is outside.
  return warp.center[0] - extent_x >= 1.5 &&
         warp.center[0] + extent_x < image.width - 2.5 &&
         warp.center[1] - extent_y >= 1.5 &&
         warp.center[1] + extent_y < image.height - 2.5;
}

// The spline around a warp's centre: offsets from it are small numbers, which
// floats hold well in images of any size.
struct SplineWindow {
  const float* origin;  // coefficient of the node before the centre
  int width;
  float x, y;  // of the centre from that node
};

MFIR_HOST_DEVICE SplineWindow MakeSplineWindow(const SplineView& image,
                                               const PatchWarp& warp) {
  const double x = floor(warp.center[0] - 0.5);
  const double y = floor(warp.center[1] - 0.5);
  return {image.coefficients + static_cast<long long>(y) * image.width +
              static_cast<long long>(x),
          image.width,
          static_cast<float>(warp.center[0] - 0.5 - x),
          static_cast<float>(warp.center[1] - 0.5 - y)};
}

// Coefficients around an offset, and its position among them.
MFIR_HOST_DEVICE const float* FindCell(const SplineWindow& window,
                                       const PatchWarp& warp,
                                       float u,
                                       float v,
                                       float* tx,
                                       float* ty) {
  const float* a = warp.affine;
  const float* q = warp.quadratic;
  const float x =
      window.x + a[0] * u + a[1] * v + u * (q[0] * u + q[1] * v) + q[2] * v * v;
  const float y =
      window.y + a[2] * u + a[3] * v + u * (q[3] * u + q[4] * v) + q[5] * v * v;
  const float cell_x = floorf(x);
  const float cell_y = floorf(y);
  *tx = x - cell_x;
  *ty = y - cell_y;
  return window.origin + (static_cast<int>(cell_y) - 1) * window.width +
         (static_cast<int>(cell_x) - 1);
}

MFIR_HOST_DEVICE float SampleOffset(const SplineWindow& window,
                                    const PatchWarp& warp,
                                    float u,
                                    float v) {
  float tx, ty, wx[4], wy[4];
  const float* corner = FindCell(window, warp, u, v, &tx, &ty);
  CubicSplineWeights(tx, wx);
  CubicSplineWeights(ty, wy);
  return WeightedSum(corner, window.width, wx, wy);
}

// Samples of the disc, from the one at the centre: sums of squares of small
// numbers lose fewer digits. The patch has to be inside.
template <typename Group>
MFIR_HOST_DEVICE void SamplePatch(const Group& group,
                                  const PatchDisc& disc,
                                  const SplineView& image,
                                  const PatchWarp& warp,
                                  float* samples) {
  const SplineWindow window = MakeSplineWindow(image, warp);
  const float center = SampleOffset(window, warp, 0.0f, 0.0f);
  for (int i = group.Rank(); i < kPatchStride; i += Group::Size()) {
    samples[i] = i < kNumPatchSamples
                     ? SampleOffset(window, warp, disc.u[i], disc.v[i]) - center
                     : 0.0f;
  }
  group.Sync();
}

template <typename Group>
MFIR_HOST_DEVICE float PatchProduct(const Group& group,
                                    const float* a,
                                    const float* b) {
  float sum = 0.0f;
  for (int i = group.Rank(); i < kPatchStride; i += Group::Size()) {
    sum += a[i] * b[i];
  }
  return group.Sum(sum);
}

// -----------------------------------------------------------------------------
// Reference patch
// -----------------------------------------------------------------------------

// Inverts a symmetric positive definite matrix by its Cholesky factor. False if
// a pivot is not above `min_pivot`.
MFIR_HOST_DEVICE bool InvertPatchMatrix(const double* matrix,
                                        double min_pivot,
                                        double* inverse) {
  constexpr int n = kNumPatchBasis;
  double l[n][n];
  for (int j = 0; j < n; ++j) {
    for (int i = j; i < n; ++i) {
      double sum = matrix[i * n + j];
      for (int k = 0; k < j; ++k) sum -= l[i][k] * l[j][k];
      if (i > j) {
        l[i][j] = sum / l[j][j];
      } else if (sum > min_pivot) {
        l[j][j] = sqrt(sum);
      } else {
        return false;
      }
    }
  }
  for (int column = 0; column < n; ++column) {
    double x[n];
    for (int i = 0; i < n; ++i) {
      x[i] = i == column ? 1.0 : 0.0;
      for (int k = 0; k < i; ++k) x[i] -= l[i][k] * x[k];
      x[i] /= l[i][i];
    }
    for (int i = n - 1; i >= 0; --i) {
      for (int k = i + 1; k < n; ++k) x[i] -= l[k][i] * x[k];
      x[i] /= l[i][i];
    }
    for (int i = 0; i < n; ++i) inverse[i * n + column] = x[i];
  }
  return true;
}

// Values and gradients of the disc around `xy`, times the factors of the basis.
template <typename Group>
MFIR_HOST_DEVICE void SampleBasis(const Group& group,
                                  const PatchDisc& disc,
                                  const SplineView& image,
                                  const PatchWarp& warp,
                                  float basis[][kPatchStride]) {
  const SplineWindow window = MakeSplineWindow(image, warp);
  for (int i = group.Rank(); i < kPatchStride; i += Group::Size()) {
    for (int k = 0; k < kNumPatchBasis; ++k) basis[k][i] = 0.0f;
    if (i >= kNumPatchSamples) continue;
    float tx, ty, wx[4], wy[4], dx[4], dy[4];
    const float* corner =
        FindCell(window, warp, disc.u[i], disc.v[i], &tx, &ty);
    CubicSplineWeights(tx, wx);
    CubicSplineWeights(ty, wy);
    CubicSplineDerivatives(tx, dx);
    CubicSplineDerivatives(ty, dy);
    const float gradient_x = WeightedSum(corner, window.width, dx, wy);
    const float gradient_y = WeightedSum(corner, window.width, wx, dy);
    const float u = disc.u[i] * (1.0f / kPatchRadius);
    const float v = disc.v[i] * (1.0f / kPatchRadius);
    basis[0][i] = gradient_x;
    basis[1][i] = gradient_y;
    basis[2][i] = gradient_x * u;
    basis[3][i] = gradient_x * v;
    basis[4][i] = gradient_y * u;
    basis[5][i] = gradient_y * v;
    basis[kGainIdx][i] = WeightedSum(corner, window.width, wx, wy);
    basis[kOffsetIdx][i] = 1.0f;
  }
  group.Sync();
}

// The gradient, by the products of the basis.
template <typename Group>
MFIR_HOST_DEVICE void SetGradient(const Group& group,
                                  const double* gram,
                                  PatchTemplate* patch) {
  constexpr int n = kNumPatchBasis;
  constexpr double kFactor = 1.0 / kNumPatchSamples;
  double products[2][2];
  for (int j = 0; j < 2; ++j) {
    const double by_patch = kFactor * gram[j * n + kGainIdx];
    const double by_one = kFactor * gram[j * n + kOffsetIdx];
    for (int i = group.Rank(); i < kPatchStride; i += Group::Size()) {
      patch->gradient[j][i] =
          patch->basis[j][i] -
          static_cast<float>(by_patch) * patch->basis[kGainIdx][i] -
          static_cast<float>(by_one) * patch->basis[kOffsetIdx][i];
    }
    for (int k = 0; k < 2; ++k) {
      products[j][k] = gram[j * n + k] - by_patch * gram[k * n + kGainIdx] -
                       by_one * gram[k * n + kOffsetIdx];
    }
  }
  if (group.Rank() != 0) return;
  const double det =
      products[0][0] * products[1][1] - products[0][1] * products[1][0];
  patch->gradient_inverse[0] = static_cast<float>(products[1][1] / det);
  patch->gradient_inverse[1] = static_cast<float>(-products[0][1] / det);
  patch->gradient_inverse[2] = static_cast<float>(products[0][0] / det);
}

// Prepares the patch around `xy`. False where it leaves the image or does not
// determine the coefficients. `patch` is shared by the group.
template <typename Group>
MFIR_HOST_DEVICE bool MakePatchTemplate(const Group& group,
                                        const PatchDisc& disc,
                                        const SplineView& image,
                                        const double* xy,
                                        PatchTemplate* patch) {
  constexpr int n = kNumPatchBasis;
  // Of a direction that the patch determines to 11 px times its relative noise.
  constexpr double kMinPivot = 1e-4 * kNumPatchSamples;
  const PatchWarp identity = {{xy[0], xy[1]},
                              {1.0f, 0.0f, 0.0f, 1.0f},
                              {0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f}};
  if (!IsPatchInside(image, identity, kPatchRadius)) return false;
  auto& basis = patch->basis;
  SampleBasis(group, disc, image, identity, basis);
  const float* ones = basis[kOffsetIdx];
  const float mean =
      PatchProduct(group, basis[kGainIdx], ones) * (1.0f / kNumPatchSamples);
  group.Sync();
  for (int i = group.Rank(); i < kNumPatchSamples; i += Group::Size()) {
    basis[kGainIdx][i] -= mean;
  }
  group.Sync();
  const float variance = PatchProduct(group, basis[kGainIdx], basis[kGainIdx]) *
                         (1.0f / kNumPatchSamples);
  if (!(variance > 1e-6f)) return false;
  const float contrast = sqrtf(variance);
  group.Sync();
  for (int k = 0; k < kOffsetIdx; ++k) {
    for (int i = group.Rank(); i < kNumPatchSamples; i += Group::Size()) {
      basis[k][i] *= 1.0f / contrast;
    }
  }
  group.Sync();
  double gram[n * n];
  for (int j = 0; j < n; ++j) {
    for (int k = 0; k <= j; ++k) {
      gram[j * n + k] = PatchProduct(group, basis[j], basis[k]);
      gram[k * n + j] = gram[j * n + k];
    }
  }
  double inverse[n * n];
  if (!InvertPatchMatrix(gram, kMinPivot, inverse)) return false;
  SetGradient(group, gram, patch);
  for (int i = group.Rank(); i < kPatchStride; i += Group::Size()) {
    for (int j = 0; j < n; ++j) {
      float sum = 0.0f;
      for (int k = 0; k < n; ++k) {
        sum += static_cast<float>(inverse[j * n + k]) * basis[k][i];
      }
      patch->projector[j][i] = sum;
    }
  }
  if (group.Rank() == 0) {
    for (int i = 0; i < n * n; ++i) {
      patch->inverse[i] = static_cast<float>(inverse[i]);
    }
    patch->contrast = contrast;
  }
  group.Sync();
  return true;
}

// -----------------------------------------------------------------------------
// Fit and alignment
// -----------------------------------------------------------------------------

// ZNCC of samples with the reference patch.
template <typename Group>
MFIR_HOST_DEVICE float PatchZncc(const Group& group,
                                 const PatchTemplate& patch,
                                 const float* samples) {
  const float mean = PatchProduct(group, patch.basis[kOffsetIdx], samples) *
                     (1.0f / kNumPatchSamples);
  const float product = PatchProduct(group, patch.basis[kGainIdx], samples);
  const float squared =
      PatchProduct(group, samples, samples) - kNumPatchSamples * mean * mean;
  // A constant patch is similar to none.
  return squared > 1e-6f * kNumPatchSamples
             ? product / sqrtf(kNumPatchSamples * squared)
             : 0.0f;
}

template <typename Group>
MFIR_HOST_DEVICE void FitCoefficients(const Group& group,
                                      const PatchTemplate& patch,
                                      const float* samples,
                                      float* coefficients) {
  for (int k = 0; k < kNumPatchBasis; ++k) {
    coefficients[k] = PatchProduct(group, patch.projector[k], samples);
  }
}

// Fit of the samples, all but the coefficients.
template <typename Group>
MFIR_HOST_DEVICE void AssessFit(const Group& group,
                                const PatchTemplate& patch,
                                const float* samples,
                                PatchFit* fit) {
  const float* c = fit->coefficients;
  float sum = 0.0f;
  for (int i = group.Rank(); i < kPatchStride; i += Group::Size()) {
    float difference = samples[i];
    for (int k = 0; k < kNumPatchBasis; ++k) {
      difference -= c[k] * patch.basis[k][i];
    }
    sum += difference * difference;
  }
  fit->noise_variance =
      group.Sum(sum) / ((kNumPatchSamples - kNumPatchBasis) *
                        fmaxf(c[kGainIdx] * c[kGainIdx], 1e-12f));
  fit->zncc = PatchZncc(group, patch, samples);
}

// Fit of the patch that the warp shows; it has to be inside. `samples`
// (kPatchStride) is shared by the group.
template <typename Group>
MFIR_HOST_DEVICE void FitPatch(const Group& group,
                               const PatchDisc& disc,
                               const PatchTemplate& patch,
                               const SplineView& image,
                               const PatchWarp& warp,
                               float* samples,
                               PatchFit* fit) {
  SamplePatch(group, disc, image, warp, samples);
  FitCoefficients(group, patch, samples, fit->coefficients);
  AssessFit(group, patch, samples, fit);
}

// The best shift of the reference patch at a warp, with gain and offset.
struct PatchShift {
  float u, v;        // pixels of the reference image
  float xx, xy, yy;  // covariance of u and v
  float zncc;        // before the shift
  float
      noise_power;  // mean square of what the fit leaves, relative to the gain
};

// Least squares for samples ~ gain (R + u R_x + v R_y) + offset. False if the
// gain is not positive. Derivatives are those of the reference patch alone:
// those of the other image would bring its noise into the equations, whose
// power depends on where between the pixels it is sampled, and so a bias.
template <typename Group>
MFIR_HOST_DEVICE bool FindPatchShift(const Group& group,
                                     const PatchTemplate& patch,
                                     const float* samples,
                                     PatchShift* shift) {
  constexpr float kFactor = 1.0f / kNumPatchSamples;
  const float gain =
      kFactor * PatchProduct(group, patch.basis[kGainIdx], samples);
  if (!(gain > 0.0f)) return false;
  const float mean =
      kFactor * PatchProduct(group, patch.basis[kOffsetIdx], samples);
  const float x = PatchProduct(group, patch.gradient[0], samples) / gain;
  const float y = PatchProduct(group, patch.gradient[1], samples) / gain;
  const float* inverse = patch.gradient_inverse;
  shift->u = inverse[0] * x + inverse[1] * y;
  shift->v = inverse[1] * x + inverse[2] * y;
  const float power =
      (kFactor * PatchProduct(group, samples, samples) - mean * mean) /
      (gain * gain);
  shift->zncc = 1.0f / sqrtf(fmaxf(power, 1.0f));
  shift->noise_power =
      fmaxf(power - 1.0f - kFactor * (shift->u * x + shift->v * y), 0.0f);
  const float variance =
      shift->noise_power * kNumPatchSamples / (kNumPatchSamples - 4);
  shift->xx = variance * inverse[0];
  shift->xy = variance * inverse[1];
  shift->yy = variance * inverse[2];
  return true;
}

// The covariance of a shift, in the other image: xx, xy, yy (px^2).
MFIR_HOST_DEVICE void MapCovariance(const PatchWarp& warp,
                                    const PatchShift& shift,
                                    float* covariance) {
  const float* a = warp.affine;
  const float x[2] = {a[0] * shift.xx + a[1] * shift.xy,
                      a[0] * shift.xy + a[1] * shift.yy};
  const float y[2] = {a[2] * shift.xx + a[3] * shift.xy,
                      a[2] * shift.xy + a[3] * shift.yy};
  covariance[0] = x[0] * a[0] + x[1] * a[1];
  covariance[1] = x[0] * a[2] + x[1] * a[3];
  covariance[2] = y[0] * a[2] + y[1] * a[3];
}

// Moves the warp by the shift back, at most kMaxPatchStep far.
MFIR_HOST_DEVICE void MoveBack(const PatchShift& shift,
                               float length,
                               PatchWarp* warp) {
  const float scale = length > kMaxPatchStep ? kMaxPatchStep / length : 1.0f;
  for (int row = 0; row < 2; ++row) {
    warp->center[row] -= scale * (warp->affine[2 * row] * shift.u +
                                  warp->affine[2 * row + 1] * shift.v);
  }
}

// Moves the centre of the warp to where the image fits the reference patch
// best. The shape of the warp stays: geometry knows it better than the few
// pixels of a patch do. `samples` (kPatchStride) is shared by the group, `warp`
// each thread's own.
template <typename Group>
MFIR_HOST_DEVICE PatchAlignment AlignPatch(const Group& group,
                                           const PatchDisc& disc,
                                           const PatchTemplate& patch,
                                           const SplineView& image,
                                           float* samples,
                                           PatchWarp* warp) {
  const double start[2] = {warp->center[0], warp->center[1]};
  PatchAlignment result = {};
  for (int i = 0; i < kMaxNumPatchIterations; ++i) {
    result.end = PatchEnd::kOutside;
    if (!IsPatchInside(image, *warp, kPatchRadius)) return result;
    group.Sync();
    SamplePatch(group, disc, image, *warp, samples);
    PatchShift shift;
    result.end = PatchEnd::kDissimilar;
    if (!FindPatchShift(group, patch, samples, &shift)) return result;
    const float length = sqrtf(shift.u * shift.u + shift.v * shift.v);
    MoveBack(shift, length, warp);
    const double dx = warp->center[0] - start[0];
    const double dy = warp->center[1] - start[1];
    result.end = PatchEnd::kDiverged;
    // Negated, so that NaN ends it.
    if (!(dx * dx + dy * dy <= kMaxPatchShift * kMaxPatchShift)) return result;
    if (length < kPatchStepTolerance) {
      // The fit is that of a hardly different warp.
      result.zncc = shift.zncc;
      MapCovariance(*warp, shift, result.covariance);
      result.end = PatchEnd::kConverged;
      return result;
    }
  }
  return result;
}

// -----------------------------------------------------------------------------
// Search
// -----------------------------------------------------------------------------

constexpr int kPatchSearchRadius = 4;  // px of the reference image
constexpr int kPatchSearchSide = 2 * kPatchSearchRadius + 1;
constexpr int kNumPatchShifts = kPatchSearchSide * kPatchSearchSide;
constexpr int kPatchSearchReach = kPatchRadius + kPatchSearchRadius;
constexpr int kPatchWindowSide = 2 * kPatchSearchReach + 1;
// With room for a row of scores that is longer than the shifts.
constexpr int kPatchWindowSize = kPatchWindowSide * kPatchWindowSide + 7;

// ZNCC of the reference patch with the disc around pixel (x, y) of a window and
// its neighbours to the right, as many as Floats has.
template <typename Floats>
MFIR_HOST_DEVICE void WindowZncc(const PatchDisc& disc,
                                 const PatchTemplate& patch,
                                 const float* window,
                                 int x,
                                 int y,
                                 float* zncc) {
  Floats sum = {};
  Floats squared = {};
  Floats product = {};
  for (int i = 0; i < kNumPatchSamples; ++i) {
    Floats samples;
    memcpy(&samples,
           window + (y + static_cast<int>(disc.v[i])) * kPatchWindowSide + x +
               static_cast<int>(disc.u[i]),
           sizeof(samples));
    sum += samples;
    squared += samples * samples;
    product += samples * patch.basis[kGainIdx][i];
  }
  for (size_t k = 0; k < sizeof(Floats) / sizeof(float); ++k) {
    const float variance =
        squared[k] - sum[k] * sum[k] * (1.0f / kNumPatchSamples);
    zncc[k] = variance > 1e-6f * kNumPatchSamples
                  ? product[k] / sqrtf(kNumPatchSamples * variance)
                  : 0.0f;
  }
}

// The best of all whole shifts up to kPatchSearchRadius in u and v, which moves
// the centre of the warp. The image is sampled once, in the pixels of the
// reference image, so that each shift costs a few products only. Returns the
// ZNCC there; -1 where the window leaves the image, which leaves the warp as it
// is. Shared by the group: `window` (kPatchWindowSize), `scores`
// (kNumPatchShifts).
template <typename Group>
MFIR_HOST_DEVICE float SearchPatch(const Group& group,
                                   const PatchDisc& disc,
                                   const PatchTemplate& patch,
                                   const SplineView& image,
                                   float* window,
                                   float* scores,
                                   PatchWarp* warp) {
  if (!IsPatchInside(image, *warp, kPatchSearchReach)) return -1.0f;
  const SplineWindow spline = MakeSplineWindow(image, *warp);
  const float center = SampleOffset(spline, *warp, 0.0f, 0.0f);
  for (int i = group.Rank(); i < kPatchWindowSide * kPatchWindowSide;
       i += Group::Size()) {
    window[i] =
        SampleOffset(
            spline,
            *warp,
            static_cast<float>(i % kPatchWindowSide - kPatchSearchReach),
            static_cast<float>(i / kPatchWindowSide - kPatchSearchReach)) -
        center;
  }
  group.Sync();
  // A thread that is alone: a row of shifts at a time.
  constexpr bool kRows = Group::Size() == 1;
  using Scores = std::conditional_t<kRows, Float16, FloatArray<1>>;
  constexpr int kNumScores = kRows ? kPatchSearchSide : 1;
  for (int i = kNumScores * group.Rank(); i < kNumPatchShifts;
       i += kNumScores * Group::Size()) {
    float zncc[sizeof(Scores) / sizeof(float)];
    WindowZncc<Scores>(disc,
                       patch,
                       window,
                       kPatchRadius + i % kPatchSearchSide,
                       kPatchRadius + i / kPatchSearchSide,
                       zncc);
    for (int k = 0; k < kNumScores; ++k) scores[i + k] = zncc[k];
  }
  group.Sync();
  int best = kNumPatchShifts / 2;
  for (int i = 0; i < kNumPatchShifts; ++i) {
    if (scores[i] > scores[best]) best = i;
  }
  const float u = static_cast<float>(best % kPatchSearchSide) -
                  static_cast<float>(kPatchSearchRadius);
  const float v = static_cast<float>(best / kPatchSearchSide) -
                  static_cast<float>(kPatchSearchRadius);
  for (int row = 0; row < 2; ++row) {
    warp->center[row] +=
        warp->affine[2 * row] * u + warp->affine[2 * row + 1] * v;
  }
  return scores[best];
}

// -----------------------------------------------------------------------------
// Many patches
// -----------------------------------------------------------------------------

// Where a reference patch is looked for, as indices of lists of both.
struct PatchJob {
  int template_idx;
  int image_idx;
  PatchWarp warp;
};

// Where AlignPatch and SearchPatch move the centre of a job's warp, and what
// they return.
struct AlignedPatch {
  PatchAlignment alignment;
  double center[2];
};
struct FoundPatch {
  float zncc;
  double center[2];
};

// Floats that the threads of a group share.
constexpr int kPatchScratchSize = kPatchWindowSize + kNumPatchShifts;
static_assert(kPatchScratchSize >= kPatchStride, "samples of a patch fit");

// One job, of the kind that its result says. A fit without gain: outside.
template <typename Group>
MFIR_HOST_DEVICE void RunPatchJob(const Group& group,
                                  const PatchDisc& disc,
                                  const PatchTemplate& patch,
                                  const SplineView& image,
                                  const PatchWarp& warp,
                                  float* scratch,
                                  PatchFit* fit) {
  *fit = {};
  if (!IsPatchInside(image, warp, kPatchRadius)) return;
  FitPatch(group, disc, patch, image, warp, scratch, fit);
}

template <typename Group>
MFIR_HOST_DEVICE void RunPatchJob(const Group& group,
                                  const PatchDisc& disc,
                                  const PatchTemplate& patch,
                                  const SplineView& image,
                                  PatchWarp warp,
                                  float* scratch,
                                  AlignedPatch* aligned) {
  aligned->alignment = AlignPatch(group, disc, patch, image, scratch, &warp);
  aligned->center[0] = warp.center[0];
  aligned->center[1] = warp.center[1];
}

template <typename Group>
MFIR_HOST_DEVICE void RunPatchJob(const Group& group,
                                  const PatchDisc& disc,
                                  const PatchTemplate& patch,
                                  const SplineView& image,
                                  PatchWarp warp,
                                  float* scratch,
                                  FoundPatch* found) {
  found->zncc = SearchPatch(
      group, disc, patch, image, scratch, scratch + kPatchWindowSize, &warp);
  found->center[0] = warp.center[0];
  found->center[1] = warp.center[1];
}

// Group `first` of `stride` groups works on every stride-th job, so that a grid
// of any size covers any number of jobs.
template <typename Group, typename Result>
MFIR_HOST_DEVICE void RunPatchJobs(const Group& group,
                                   int64_t first,
                                   int64_t stride,
                                   const PatchDisc& disc,
                                   const PatchTemplate* templates,
                                   const SplineView* images,
                                   const PatchJob* jobs,
                                   int64_t num_jobs,
                                   float* scratch,
                                   Result* results) {
  for (int64_t i = first; i < num_jobs; i += stride) {
    const PatchJob& job = jobs[i];
    Result result;
    RunPatchJob(group,
                disc,
                templates[job.template_idx],
                images[job.image_idx],
                job.warp,
                scratch,
                &result);
    // Nobody overwrites what others still read.
    group.Sync();
    if (group.Rank() == 0) results[i] = result;
  }
}

}  // namespace mfir
