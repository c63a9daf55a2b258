// Medians of values that are spread over processes, and of many in one.

#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <utility>
#include <vector>

#include "src/parallel/communicator.h"

namespace mfir {

// A value with its weight.
struct WeightedValue {
  double value = 0.0;   // not negative, may be infinite
  double weight = 1.0;  // positive
};

namespace internal {

// The order of such numbers is that of their bits.
inline uint64_t Bits(double value) {
  uint64_t bits = 0;
  std::memcpy(&bits, &value, sizeof(bits));
  return bits;
}

}  // namespace internal

// The smallest of all ranks' values such that the weights of all values up to
// it sum up to `target`, at most their total. `get(i)` is value i of `count` on
// this rank. Finds the bits of the value, a few at a time, from histograms that
// are summed over the ranks: exact, and linear in the number of values.
template <typename Get>
double ValueAtWeight(size_t count,
                     const Get& get,
                     double target,
                     const Communicator& ranks) {
  constexpr int kNumBits = 11;
  constexpr uint64_t kMask = (1u << kNumBits) - 1;
  std::vector<std::pair<uint64_t, double>> candidates;
  uint64_t found = 0;
  double below = 0.0;
  for (const int shift : {53, 42, 31, 20, 9, -2}) {
    const auto bin_of = [shift](uint64_t bits) {
      return (shift >= 0 ? bits >> shift : bits << -shift) & kMask;
    };
    const bool is_first = shift == 53;
    const size_t num = is_first ? count : candidates.size();
    std::array<double, kMask + 1> histogram = {};
    for (size_t i = 0; i < num; ++i) {
      if (is_first) {
        const WeightedValue value = get(i);
        histogram[bin_of(internal::Bits(value.value))] += value.weight;
      } else {
        histogram[bin_of(candidates[i].first)] += candidates[i].second;
      }
    }
    ranks.Sum(histogram.data(), histogram.size());
    uint64_t bin = 0;
    double sum = below;
    for (uint64_t b = 0; b <= kMask; ++b) {
      if (histogram[b] == 0.0) continue;
      bin = b;
      below = sum;
      sum += histogram[b];
      if (sum >= target) break;
    }
    found |= shift >= 0 ? bin << shift : bin >> -shift;
    std::vector<std::pair<uint64_t, double>> rest;
    for (size_t i = 0; i < num; ++i) {
      if (is_first) {
        const WeightedValue value = get(i);
        const uint64_t bits = internal::Bits(value.value);
        if (bin_of(bits) == bin) rest.emplace_back(bits, value.weight);
      } else if (bin_of(candidates[i].first) == bin) {
        rest.push_back(candidates[i]);
      }
    }
    candidates = std::move(rest);
  }
  double value = 0.0;
  std::memcpy(&value, &found, sizeof(value));
  return value;
}

// Value number k, from 0, in ascending order, of all ranks' values.
inline double KthSmallest(const std::vector<double>& values,
                          size_t k,
                          const Communicator& ranks) {
  return ValueAtWeight(
      values.size(),
      [&](size_t i) {
        return WeightedValue{values[i], 1.0};
      },
      static_cast<double>(k + 1),
      ranks);
}

// As in median.h, of all ranks' values, which must not be negative.
inline double UpperMedian(const std::vector<double>& values,
                          const Communicator& ranks) {
  const size_t num = Sum(ranks, values.size());
  if (num == 0) return std::numeric_limits<double>::quiet_NaN();
  return KthSmallest(values, num / 2, ranks);
}

inline double Median(const std::vector<double>& values,
                     const Communicator& ranks) {
  const size_t num = Sum(ranks, values.size());
  const double upper = KthSmallest(values, num / 2, ranks);
  if (num % 2 == 1) return upper;
  return 0.5 * (upper + KthSmallest(values, num / 2 - 1, ranks));
}

}  // namespace mfir
