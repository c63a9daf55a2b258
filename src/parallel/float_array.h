// Some neighbouring floats as one value.

#pragma once

#include "src/util/half_float.h"

namespace mfir {

template <int kCount>
struct FloatArray {
  float values[kCount];

  MFIR_HOST_DEVICE float operator[](int i) const { return values[i]; }

  MFIR_HOST_DEVICE FloatArray& operator+=(const FloatArray& other) {
    for (int i = 0; i < kCount; ++i) values[i] += other.values[i];
    return *this;
  }

  MFIR_HOST_DEVICE friend FloatArray operator*(const FloatArray& a,
                                               const FloatArray& b) {
    FloatArray product;
    for (int i = 0; i < kCount; ++i) product.values[i] = a[i] * b[i];
    return product;
  }

  MFIR_HOST_DEVICE friend FloatArray operator*(const FloatArray& a, float b) {
    FloatArray product;
    for (int i = 0; i < kCount; ++i) product.values[i] = a[i] * b;
    return product;
  }
};

// On a CPU the compiler's vectors, which have the same operators: it does not
// make vector instructions of short loops over arrays.
#if defined(__GNUC__) && !defined(__CUDACC__)
typedef float Float4 __attribute__((vector_size(16)));
typedef float Float16 __attribute__((vector_size(64)));
#else
using Float4 = FloatArray<4>;
using Float16 = FloatArray<16>;
#endif

}  // namespace mfir
