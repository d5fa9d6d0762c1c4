// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/evenly_spaced.h"

#include <gtest/gtest.h>

namespace redrive {
namespace {

TEST(EvenlySpaced, TakesTheMiddlesOfEqualIntervals) {
  EXPECT_EQ(evenly_spaced(5, 0), (std::vector<std::size_t>{0, 1, 2, 3, 4}));
  EXPECT_EQ(evenly_spaced(5, 9), (std::vector<std::size_t>{0, 1, 2, 3, 4}));
  EXPECT_EQ(evenly_spaced(9, 3), (std::vector<std::size_t>{1, 4, 7}));
  EXPECT_EQ(evenly_spaced(50, 1), (std::vector<std::size_t>{25}));
  EXPECT_TRUE(evenly_spaced(0, 3).empty());
}

}  // namespace
}  // namespace redrive
