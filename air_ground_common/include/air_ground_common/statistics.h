// Order statistics of samples.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <utility>
#include <vector>

namespace air_ground_common {

/// The value at rank q (n - 1), rounded, of n values in ascending order; q in [0, 1]. NaN without values.
template <typename T>
T quantile(std::vector<T> values, double q) {
  if (values.empty()) return std::numeric_limits<T>::quiet_NaN();
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(std::lround(q * static_cast<double>(values.size() - 1)));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

/// The middle one; of an even number of values the upper one of two.
template <typename T>
T median(std::vector<T> values) {
  return quantile(std::move(values), 0.5);
}

}  // namespace air_ground_common
