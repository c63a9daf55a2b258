#include "src/parallel/float_array.h"

#include <cstring>

#include <gtest/gtest.h>

namespace mfir {
namespace {

// What kernels of a GPU use and what the CPU does: the same numbers.
template <typename Floats>
float Sum(int count) {
  Floats a, b;
  for (int i = 0; i < count; ++i) {
    const float x = 0.5f * static_cast<float>(i);
    const float y = 3.0f - static_cast<float>(i);
    std::memcpy(reinterpret_cast<char*>(&a) + 4 * i, &x, 4);
    std::memcpy(reinterpret_cast<char*>(&b) + 4 * i, &y, 4);
  }
  a += a * b;
  a += b * 2.0f;
  float sum = 0.0f;
  for (int i = 0; i < count; ++i) sum += static_cast<float>(i + 1) * a[i];
  return sum;
}

TEST(FloatArray, HasTheOperatorsOfVectors) {
  // a = (0, .5, 1, 1.5), b = (3, 2, 1, 0): a + a b + 2 b = (6, 5.5, 4, 1.5).
  EXPECT_EQ(Sum<FloatArray<4>>(4), 6.0f + 2 * 5.5f + 3 * 4.0f + 4 * 1.5f);
  EXPECT_EQ(Sum<Float4>(4), Sum<FloatArray<4>>(4));
  EXPECT_EQ(Sum<Float16>(16), Sum<FloatArray<16>>(16));
}

}  // namespace
}  // namespace mfir
