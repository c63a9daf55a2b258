#include "src/util/half_float.h"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>
#include <Eigen/Core>

namespace mfir {
namespace {

TEST(HalfFloat, EveryHalfConvertsExactly) {
  for (uint32_t i = 0; i < 65536; ++i) {
    const uint16_t half = static_cast<uint16_t>(i);
    const float expected = static_cast<float>(
        Eigen::half(Eigen::half_impl::raw_uint16_to_half(half)));
    const float value = HalfToFloat(half);
    if (std::isnan(expected)) {
      EXPECT_TRUE(std::isnan(value)) << i;
      EXPECT_TRUE(std::isnan(HalfToFloat(FloatToHalf(value)))) << i;
    } else {
      EXPECT_EQ(value, expected) << i;
      EXPECT_EQ(std::signbit(value), std::signbit(expected)) << i;
      EXPECT_EQ(FloatToHalf(value), half) << i;
    }
    EXPECT_EQ(IsFiniteHalf(half), std::isfinite(expected)) << i;
  }
}

TEST(HalfFloat, RoundsToNearestEven) {
  // All floats with some of the upper bits, ties among them.
  for (uint64_t bits = 0; bits < (uint64_t{1} << 32); bits += 0x7ff) {
    for (const uint32_t low : {0u, 1u}) {
      const float value =
          BitsToFloat((static_cast<uint32_t>(bits) & 0xfffff000u) | low);
      if (std::isnan(value)) continue;
      ASSERT_EQ(FloatToHalf(value), Eigen::half(value).x) << value;
    }
  }
  EXPECT_EQ(FloatToHalf(1.0f + 1.0f / 2048.0f), FloatToHalf(1.0f));
  EXPECT_EQ(HalfToFloat(FloatToHalf(1.0f + 3.0f / 2048.0f)),
            1.0f + 2.0f / 1024.0f);
}

TEST(HalfFloat, ClampsWhatIsTooLarge) {
  EXPECT_EQ(HalfToFloat(FloatToClampedHalf(1e9f)), kMaxHalf);
  EXPECT_EQ(HalfToFloat(FloatToClampedHalf(-1e9f)), -kMaxHalf);
  EXPECT_EQ(HalfToFloat(FloatToClampedHalf(0.25f)), 0.25f);
  EXPECT_TRUE(std::isnan(HalfToFloat(
      FloatToClampedHalf(std::numeric_limits<float>::quiet_NaN()))));
}

}  // namespace
}  // namespace mfir
