// Median of a few or many numbers.

#pragma once

#include <algorithm>
#include <limits>
#include <vector>

namespace mfir {

// The upper one of the two in the middle of an even number; NaN if there is
// none.
inline double UpperMedian(std::vector<double> values) {
  if (values.empty()) return std::numeric_limits<double>::quiet_NaN();
  const auto middle = values.begin() + values.size() / 2;
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// Of an even number the mean of the two in the middle. There must be one.
inline double Median(std::vector<double> values) {
  const auto middle = values.begin() + values.size() / 2;
  std::nth_element(values.begin(), middle, values.end());
  if (values.size() % 2 == 1) return *middle;
  return 0.5 * (*middle + *std::max_element(values.begin(), middle));
}

}  // namespace mfir
