// Bicubic (Catmull-Rom) interpolation on a patch of samples.

#pragma once

#include "src/util/half_float.h"

namespace mfir {

// The least number of samples along a side.
constexpr int kMinCubicSize = 4;

// Value at a position: sum_i weight[i] * sample[begin + i], its derivative by
// the position: sum_i derivative[i] * sample[begin + i].
struct CubicWeights {
  int begin;
  double weight[4];
  double derivative[4];
};

// Folds the weights of samples -1, 0, 1, 2 into those of samples 0, 1, 2, 3:
// sample -1 continues the parabola through the next three.
MFIR_HOST_DEVICE void FoldBorderSample(double* w) {
  const double outer = w[0];
  w[0] = w[1] + 3.0 * outer;
  w[1] = w[2] - 3.0 * outer;
  w[2] = w[3] + outer;
  w[3] = 0.0;
}

// The same for samples size - 3 ... size at the other end.
MFIR_HOST_DEVICE void FoldLastBorderSample(double* w) {
  const double outer = w[3];
  w[3] = w[2] + 3.0 * outer;
  w[2] = w[1] - 3.0 * outer;
  w[1] = w[0] + outer;
  w[0] = 0.0;
}

// Weights at position x, where sample i of `size` (at least kMinCubicSize) lies
// at x = i. They sum to one, their derivatives to zero, and both are continuous
// for all x:
// - inside, the Catmull-Rom spline. In the outermost cells the missing sample
//   continues the parabola through the last three, so that a derivative at a
//   border sample has the second-order accuracy of a central difference;
// - outside, the position goes on for another half sample (up to the edge of
//   the pixel) while its speed falls to zero, and stays there from one sample
//   outside: a constant value, zero derivative. NaN counts as far outside.
MFIR_HOST_DEVICE CubicWeights MakeCubicWeights(double x, int size) {
  const double last = size - 1;
  double speed = 1.0;
  if (!(x >= 0.0)) {
    const double excess = x > -1.0 ? -x : 1.0;
    x = -(excess - 0.5 * excess * excess);
    speed = 1.0 - excess;
  } else if (x > last) {
    const double excess = x < last + 1.0 ? x - last : 1.0;
    x = last + (excess - 0.5 * excess * excess);
    speed = 1.0 - excess;
  }
  int cell = x > 0.0 ? static_cast<int>(x) : 0;
  if (cell > size - 2) cell = size - 2;
  const double t = x - cell;

  CubicWeights result;
  double* w = result.weight;
  w[0] = t * (-0.5 + t * (1.0 - 0.5 * t));
  w[1] = 1.0 + t * t * (-2.5 + 1.5 * t);
  w[2] = t * (0.5 + t * (2.0 - 1.5 * t));
  w[3] = t * t * (-0.5 + 0.5 * t);
  double* d = result.derivative;
  d[0] = speed * (-0.5 + t * (2.0 - 1.5 * t));
  d[1] = speed * t * (-5.0 + 4.5 * t);
  d[2] = speed * (0.5 + t * (4.0 - 4.5 * t));
  d[3] = speed * t * (-1.0 + 1.5 * t);
  result.begin = cell - 1;
  if (cell == 0) {
    result.begin = 0;
    FoldBorderSample(w);
    FoldBorderSample(d);
  } else if (cell == size - 2) {
    result.begin = size - 4;
    FoldLastBorderSample(w);
    FoldLastBorderSample(d);
  }
  return result;
}

}  // namespace mfir
