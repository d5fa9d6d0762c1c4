// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/numbers.h"

#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include <gtest/gtest.h>

namespace redrive {
namespace {

TEST(Numbers, MeanIsSummedInDouble) {
  for (const std::size_t n : {1u, 63u, 64u, 65u, 20011u}) {
    // Integers whose sum is exact in double but not in float.
    std::vector<float> numbers(n);
    double expected = 0;
    for (std::size_t i = 0; i < n; ++i)
      expected += numbers[i] = static_cast<float>((1 << 23) + 3 * i);
    EXPECT_EQ(mean_of(numbers), expected / static_cast<double>(n));
  }
  EXPECT_THROW(mean_of({}), std::logic_error);
}

TEST(Numbers, AllFiniteFindsInfinityAndNaN) {
  EXPECT_TRUE(all_finite({}));
  for (const std::size_t n : {1u, 100u, 5000u}) {
    const std::vector<float> numbers(n, std::numeric_limits<float>::max());
    EXPECT_TRUE(all_finite(numbers));
    for (const float bad : {INFINITY, -INFINITY, NAN})
      for (const std::size_t at : {std::size_t{0}, n / 2, n - 1}) {
        std::vector<float> corrupted = numbers;
        corrupted[at] = bad;
        EXPECT_FALSE(all_finite(corrupted)) << bad << " at " << at << " of " << n;
      }
  }
}

}  // namespace
}  // namespace redrive
