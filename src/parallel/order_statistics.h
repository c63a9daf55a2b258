// Medians of values that are spread over processes, and of many in one.

#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <utility>
#include <vector>

#include "src/parallel/communicator.h"
#include "src/parallel/parallel_for.h"

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
                     const Communicator& ranks,
                     int num_threads = 1) {
  constexpr int kNumBits = 11;
  constexpr uint64_t kMask = (1u << kNumBits) - 1;
  using Histogram = std::array<double, kMask + 1>;
  // Sums by chunk, so that they do not depend on the number of threads.
  const size_t chunk_size = std::max<size_t>(65536, count / 64);
  const size_t num_chunks = (count + chunk_size - 1) / chunk_size;
  std::vector<std::vector<std::pair<uint64_t, double>>> candidates(num_chunks);
  std::vector<Histogram> histograms(num_chunks);
  uint64_t found = 0;
  double below = 0.0;
  for (const int shift : {53, 42, 31, 20, 9, -2}) {
    const auto bin_of = [shift](uint64_t bits) {
      return (shift >= 0 ? bits >> shift : bits << -shift) & kMask;
    };
    // Calls function(bits, weight) for all values in the first round, then for
    // the candidates.
    const auto for_each = [&](size_t chunk, const auto& function) {
      if (shift != 53) {
        for (const auto& [bits, weight] : candidates[chunk]) {
          function(bits, weight);
        }
        return;
      }
      const size_t end = std::min(count, (chunk + 1) * chunk_size);
      for (size_t i = chunk * chunk_size; i < end; ++i) {
        const WeightedValue value = get(i);
        function(internal::Bits(value.value), value.weight);
      }
    };
    ParallelFor(num_chunks, num_threads, [&](size_t chunk) {
      histograms[chunk].fill(0.0);
      for_each(chunk, [&](uint64_t bits, double weight) {
        histograms[chunk][bin_of(bits)] += weight;
      });
    });
    Histogram histogram = {};
    for (const Histogram& part : histograms) {
      for (uint64_t b = 0; b <= kMask; ++b) histogram[b] += part[b];
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
    ParallelFor(num_chunks, num_threads, [&](size_t chunk) {
      std::vector<std::pair<uint64_t, double>> rest;
      for_each(chunk, [&](uint64_t bits, double weight) {
        if (bin_of(bits) == bin) rest.emplace_back(bits, weight);
      });
      candidates[chunk] = std::move(rest);
    });
  }
  double value = 0.0;
  std::memcpy(&value, &found, sizeof(value));
  return value;
}

// Value number k, from 0, in ascending order, of all ranks' values.
inline double KthSmallest(const std::vector<double>& values,
                          size_t k,
                          const Communicator& ranks,
                          int num_threads = 1) {
  return ValueAtWeight(
      values.size(),
      [&](size_t i) {
        return WeightedValue{values[i], 1.0};
      },
      static_cast<double>(k + 1),
      ranks,
      num_threads);
}

// As in median.h, of all ranks' values, which must not be negative.
inline double UpperMedian(const std::vector<double>& values,
                          const Communicator& ranks) {
  const size_t num = Sum(ranks, values.size());
  if (num == 0) return std::numeric_limits<double>::quiet_NaN();
  return KthSmallest(values, num / 2, ranks);
}

inline double Median(const std::vector<double>& values,
                     const Communicator& ranks,
                     int num_threads = 1) {
  const size_t num = Sum(ranks, values.size());
  const double upper = KthSmallest(values, num / 2, ranks, num_threads);
  if (num % 2 == 1) return upper;
  return 0.5 * (upper + KthSmallest(values, num / 2 - 1, ranks, num_threads));
}

}  // namespace mfir
