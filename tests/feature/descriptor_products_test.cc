#include "src/feature/descriptor_products.h"

#include <vector>

#include <gtest/gtest.h>

#include "src/util/random.h"

namespace mfir {
namespace {

constexpr size_t kNumDescriptors = 37;

std::vector<uint8_t> RandomBytes(size_t count, Random* random) {
  std::vector<uint8_t> bytes;
  for (size_t i = 0; i < count; ++i) {
    bytes.push_back(static_cast<uint8_t>(random->Integer(0, 255)));
  }
  return bytes;
}

class DescriptorProductsTest : public testing::TestWithParam<InstructionSet> {
 protected:
  // Products of `query` with descriptors `idxs`.
  static std::vector<int32_t> Compute(DescriptorProductsFunction function,
                                      const std::vector<uint8_t>& query,
                                      const std::vector<uint8_t>& descriptors,
                                      const std::vector<uint32_t>& idxs) {
    std::vector<int32_t> products(idxs.size(), -1);
    function(query.data(),
             descriptors.data(),
             idxs.data(),
             idxs.size(),
             products.data());
    return products;
  }
};

TEST_P(DescriptorProductsTest, EqualTheSums) {
  const DescriptorProductsFunction function =
      FindDescriptorProducts(GetParam());
  if (function == nullptr) GTEST_SKIP() << "not on this machine";
  Random random({5});
  const auto query = RandomBytes(kSiftDescriptorSize, &random);
  const auto descriptors =
      RandomBytes(kNumDescriptors * kSiftDescriptorSize, &random);
  std::vector<uint32_t> idxs = {36, 0, 7, 7, 35};
  for (uint32_t i = 0; i < kNumDescriptors; ++i) idxs.push_back(i);
  std::vector<int32_t> expected;
  for (const uint32_t idx : idxs) {
    int32_t sum = 0;
    for (size_t i = 0; i < kSiftDescriptorSize; ++i) {
      sum += query[i] * descriptors[idx * kSiftDescriptorSize + i];
    }
    expected.push_back(sum);
  }
  EXPECT_EQ(Compute(function, query, descriptors, idxs), expected);
  EXPECT_TRUE(Compute(function, query, descriptors, {}).empty());
}

TEST_P(DescriptorProductsTest, LargestBytesDoNotOverflow) {
  const DescriptorProductsFunction function =
      FindDescriptorProducts(GetParam());
  if (function == nullptr) GTEST_SKIP() << "not on this machine";
  const std::vector<uint8_t> largest(kSiftDescriptorSize, 255);
  EXPECT_EQ(Compute(function, largest, largest, {0}),
            std::vector<int32_t>{128 * 255 * 255});
}

INSTANTIATE_TEST_SUITE_P(All,
                         DescriptorProductsTest,
                         testing::Values(InstructionSet::kScalar,
                                         InstructionSet::kSse2,
                                         InstructionSet::kAvx2));

TEST(BestDescriptorProducts, IsOneOfThem) {
  EXPECT_NE(BestDescriptorProducts(), nullptr);
#if defined(__x86_64__)
  EXPECT_NE(BestDescriptorProducts(),
            FindDescriptorProducts(InstructionSet::kScalar));
#endif
}

}  // namespace
}  // namespace mfir
