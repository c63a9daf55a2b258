// IEEE half precision (fp16) as stored in feature patches and cost maps.
//
// Own code and not Eigen::half: it compiles to the same arithmetic in CUDA
// kernels, and has no branches, so that loops over it vectorize.

#pragma once

#include <cstdint>
#include <cstring>

// Functions that run on the CPU and in CUDA kernels. Always inlined, since a
// function compiled for several instruction sets needs its callees compiled
// for them as well.
#if defined(__CUDACC__)
#define MFIR_HOST_DEVICE __host__ __device__ __forceinline__
#else
#define MFIR_HOST_DEVICE inline __attribute__((always_inline))
#endif

namespace mfir {

constexpr float kMaxHalf = 65504.0f;

MFIR_HOST_DEVICE float BitsToFloat(uint32_t bits) {
  float value;
  memcpy(&value, &bits, sizeof(value));
  return value;
}

MFIR_HOST_DEVICE uint32_t FloatToBits(float value) {
  uint32_t bits;
  memcpy(&bits, &value, sizeof(bits));
  return bits;
}

// Exact.
MFIR_HOST_DEVICE float HalfToFloat(uint16_t half) {
  // The bits as those of a float; its exponent has another bias, which a
  // multiplication by 2^112 makes up for, also for subnormals.
  const uint32_t magnitude = static_cast<uint32_t>(half & 0x7fffu) << 13;
  uint32_t bits = FloatToBits(BitsToFloat(magnitude) * 5.192296858534828e33f);
  bits |= magnitude >= (0x7c00u << 13) ? 0x7f800000u : 0u;  // Inf, NaN
  return BitsToFloat(bits | static_cast<uint32_t>(half & 0x8000u) << 16);
}

// Rounds to nearest, ties to even. Without branches, too.
MFIR_HOST_DEVICE uint16_t FloatToHalf(float value) {
  const uint32_t bits = FloatToBits(value);
  const uint32_t sign = (bits >> 16) & 0x8000u;
  const uint32_t magnitude = bits & 0x7fffffffu;
  // Subnormal: the last place of 0.5f is the unit of subnormal halves.
  const uint32_t subnormal =
      FloatToBits(BitsToFloat(magnitude) + 0.5f) - 0x3f000000u;
  const uint32_t normal =
      (magnitude - 0x38000000u + 0xfffu + ((magnitude >> 13) & 1u)) >> 13;
  uint32_t half = magnitude < 0x38800000u ? subnormal : normal;
  half = magnitude >= 0x477ff000u ? 0x7c00u : half;  // more than kMaxHalf
  half = magnitude > 0x7f800000u ? 0x7e00u : half;   // NaN
  return static_cast<uint16_t>(sign | half);
}

// Finite values beyond the range become the largest half.
MFIR_HOST_DEVICE uint16_t FloatToClampedHalf(float value) {
  return FloatToHalf(value > kMaxHalf    ? kMaxHalf
                     : value < -kMaxHalf ? -kMaxHalf
                                         : value);
}

MFIR_HOST_DEVICE bool IsFiniteHalf(uint16_t half) {
  return (half & 0x7c00u) != 0x7c00u;
}

}  // namespace mfir
