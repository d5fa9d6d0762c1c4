// SPDX-License-Identifier: Apache-2.0
// Compares arrays with a tolerance per element; NaN and infinity always fail.
#pragma once

#include <cmath>
#include <cstring>
#include <functional>
#include <span>

#include <gtest/gtest.h>

namespace redrive::kernels::conformance {

/// Checks that got[i] is within tolerance(i) of expected(i) for every i, and reports the worst
/// element.
inline testing::AssertionResult all_near(std::span<const float> got,
                                         const std::function<double(std::size_t)>& expected,
                                         const std::function<double(std::size_t)>& tolerance) {
  double worst = 0;
  std::size_t where = 0, failures = 0;
  for (std::size_t i = 0; i < got.size(); ++i) {
    const double error = std::abs(got[i] - expected(i)), allowed = tolerance(i);
    if (error <= allowed) continue;
    ++failures;
    const double ratio = std::isfinite(error) ? error / allowed : INFINITY;
    if (ratio > worst || failures == 1) {
      worst = ratio;
      where = i;
    }
  }
  if (failures == 0) return testing::AssertionSuccess();
  return testing::AssertionFailure()
         << failures << " of " << got.size() << " elements are off, the worst at " << where << ": "
         << got[where] << " instead of " << expected(where) << ", allowed " << tolerance(where)
         << " (" << worst << " times)";
}

inline testing::AssertionResult bit_equal(std::span<const float> a, std::span<const float> b) {
  if (a.size() != b.size())
    return testing::AssertionFailure() << a.size() << " and " << b.size() << " elements";
  for (std::size_t i = 0; i < a.size(); ++i)
    if (std::memcmp(&a[i], &b[i], sizeof(float)) != 0)
      return testing::AssertionFailure() << "element " << i << ": " << a[i] << " and " << b[i];
  return testing::AssertionSuccess();
}

}  // namespace redrive::kernels::conformance
