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

}  // namespace mfir
