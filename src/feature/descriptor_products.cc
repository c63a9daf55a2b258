#include "src/feature/descriptor_products.h"

#include <initializer_list>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

namespace mfir {
namespace {

void ProductsScalar(const uint8_t* query,
                    const uint8_t* descriptors,
                    const uint32_t* idxs,
                    size_t count,
                    int32_t* products) {
  for (size_t k = 0; k < count; ++k) {
    const uint8_t* other = descriptors + idxs[k] * kSiftDescriptorSize;
    int32_t sum = 0;
    for (size_t i = 0; i < kSiftDescriptorSize; ++i) sum += query[i] * other[i];
    products[k] = sum;
  }
}

// Bytes are widened to 16 bits, since the instructions that multiply bytes
// saturate. Sums of two products fit into 32 bits.
#if defined(__x86_64__)
// Part of every x86-64.
void ProductsSse2(const uint8_t* query,
                  const uint8_t* descriptors,
                  const uint32_t* idxs,
                  size_t count,
                  int32_t* products) {
  constexpr size_t kNumBlocks = kSiftDescriptorSize / 16;
  const __m128i zero = _mm_setzero_si128();
  const auto load = [](const uint8_t* data) {
    return _mm_loadu_si128(reinterpret_cast<const __m128i*>(data));
  };
  for (size_t k = 0; k < count; ++k) {
    const uint8_t* other = descriptors + idxs[k] * kSiftDescriptorSize;
    __m128i sum = zero;
    for (size_t i = 0; i < kNumBlocks; ++i) {
      const __m128i a = load(query + 16 * i);
      const __m128i b = load(other + 16 * i);
      const __m128i low = _mm_madd_epi16(_mm_unpacklo_epi8(a, zero),
                                         _mm_unpacklo_epi8(b, zero));
      const __m128i high = _mm_madd_epi16(_mm_unpackhi_epi8(a, zero),
                                          _mm_unpackhi_epi8(b, zero));
      sum = _mm_add_epi32(sum, _mm_add_epi32(low, high));
    }
    sum = _mm_add_epi32(sum, _mm_shuffle_epi32(sum, _MM_SHUFFLE(1, 0, 3, 2)));
    sum = _mm_add_epi32(sum, _mm_shuffle_epi32(sum, _MM_SHUFFLE(2, 3, 0, 1)));
    products[k] = _mm_cvtsi128_si32(sum);
  }
}

__attribute__((target("avx2"))) void ProductsAvx2(const uint8_t* query,
                                                  const uint8_t* descriptors,
                                                  const uint32_t* idxs,
                                                  size_t count,
                                                  int32_t* products) {
  constexpr size_t kNumBlocks = kSiftDescriptorSize / 16;
  // No lambda: it would not inherit the target.
  __m256i wide_query[kNumBlocks];
  for (size_t i = 0; i < kNumBlocks; ++i) {
    wide_query[i] = _mm256_cvtepu8_epi16(
        _mm_loadu_si128(reinterpret_cast<const __m128i*>(query + 16 * i)));
  }
  for (size_t k = 0; k < count; ++k) {
    const uint8_t* other = descriptors + idxs[k] * kSiftDescriptorSize;
    __m256i sum = _mm256_setzero_si256();
    for (size_t i = 0; i < kNumBlocks; ++i) {
      const __m256i wide_other = _mm256_cvtepu8_epi16(
          _mm_loadu_si128(reinterpret_cast<const __m128i*>(other + 16 * i)));
      sum = _mm256_add_epi32(sum, _mm256_madd_epi16(wide_query[i], wide_other));
    }
    __m128i half = _mm_add_epi32(_mm256_castsi256_si128(sum),
                                 _mm256_extracti128_si256(sum, 1));
    half =
        _mm_add_epi32(half, _mm_shuffle_epi32(half, _MM_SHUFFLE(1, 0, 3, 2)));
    half =
        _mm_add_epi32(half, _mm_shuffle_epi32(half, _MM_SHUFFLE(2, 3, 0, 1)));
    products[k] = _mm_cvtsi128_si32(half);
  }
}
#endif

}  // namespace

DescriptorProductsFunction FindDescriptorProducts(InstructionSet instructions) {
  switch (instructions) {
    case InstructionSet::kScalar:
      return &ProductsScalar;
#if defined(__x86_64__)
    case InstructionSet::kSse2:
      return &ProductsSse2;
    case InstructionSet::kAvx2:
      return __builtin_cpu_supports("avx2") ? &ProductsAvx2 : nullptr;
#endif
    default:
      return nullptr;
  }
}

DescriptorProductsFunction BestDescriptorProducts() {
  for (const InstructionSet instructions :
       {InstructionSet::kAvx2, InstructionSet::kSse2}) {
    const DescriptorProductsFunction function =
        FindDescriptorProducts(instructions);
    if (function != nullptr) return function;
  }
  return FindDescriptorProducts(InstructionSet::kScalar);
}

}  // namespace mfir
