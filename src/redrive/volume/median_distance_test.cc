// SPDX-License-Identifier: Apache-2.0
#include "redrive/volume/median_distance.h"

#include <limits>

#include <gtest/gtest.h>

namespace redrive {
namespace {

const float kEdges[] = {1, 2, 4, 8, 16};

float median(const float (&weights)[4]) {
  return median_distance(kEdges, weights, 4, weights[0] + weights[1] + weights[2] + weights[3]);
}

TEST(MedianDistance, IsWhereHalfTheOpacityIsReached) {
  EXPECT_EQ(median({0, 0.5f, 0, 0}), 3) << "the middle of the only interval with weight";
  EXPECT_EQ(median({0.25f, 0.125f, 0.125f, 0}), 2) << "the end of the first";
  EXPECT_EQ(median({0.125f, 0, 0.375f, 0}), 4 + 4 / 3.0f) << "0.125 of 0.375 further";
  EXPECT_EQ(median({0.25f, 0, 0, 0.25f}), 2) << "not between the two surfaces";
}

TEST(MedianDistance, IsTheFarEdgeOfAnEmptyRay) {
  EXPECT_EQ(median({0, 0, 0, 0}), 16);
  EXPECT_EQ(median({std::numeric_limits<float>::quiet_NaN(), 0, 0, 0}), 16);
}

}  // namespace
}  // namespace redrive
