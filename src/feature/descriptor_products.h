// Inner products of SIFT descriptors, with the instructions that the machine
// has.

#pragma once

#include <cstddef>
#include <cstdint>

namespace mfir {

inline constexpr size_t kSiftDescriptorSize = 128;

// products[k] = inner product of `query` and descriptor idxs[k] of
// `descriptors`, kSiftDescriptorSize bytes each. Exact: at most 128 * 255^2.
using DescriptorProductsFunction = void (*)(const uint8_t* query,
                                            const uint8_t* descriptors,
                                            const uint32_t* idxs,
                                            size_t count,
                                            int32_t* products);

enum class InstructionSet { kScalar, kSse2, kAvx2 };

// nullptr where this machine, or the compiler's target, does not have them.
DescriptorProductsFunction FindDescriptorProducts(InstructionSet instructions);

// The fastest of them. All give the same numbers.
DescriptorProductsFunction BestDescriptorProducts();

}  // namespace mfir
