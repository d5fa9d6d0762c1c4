// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/bundle/lane_edges.h"

#include <cmath>
#include <functional>
#include <vector>

#include <gtest/gtest.h>

#include "redrive/base/rng.h"

namespace redrive {
namespace {

/// Makes returns along 80 m, with the intensity of their place, give or take 30 %.
std::vector<WayReturn> returns_of(const std::function<double(double along, double across)>& road) {
  std::vector<WayReturn> returns;
  for (std::uint64_t i = 0; i < 40'000; ++i) {
    const double along = 80.0 * random_unit(3, 3 * i),
                 across = 10.0 * random_unit(3, 3 * i + 1) - 5;
    returns.push_back(
        {along, across, road(along, across) * (0.7 + 0.6 * random_unit(3, 3 * i + 2))});
  }
  return returns;
}

bool is_line(double across, double at) { return std::abs(across - at) < 0.08; }
bool is_dash(double along) { return std::fmod(along, 12) < 4; }

TEST(LaneEdges, FindsLinesAndDashes) {
  const auto edges = find_lane_edges(returns_of([](double along, double across) {
    return is_line(across, 1.45) && is_dash(along)           ? 0.5
           : is_line(across, -1.95) || is_line(across, -2.8) ? 0.4
                                                             : 0.1;
  }));
  ASSERT_TRUE(edges);
  EXPECT_NEAR(edges->left_m, 1.45, 0.06);
  EXPECT_NEAR(edges->right_m, -1.95, 0.06);
}

TEST(LaneEdges, TakesNothingElseForLines) {
  EXPECT_FALSE(find_lane_edges({}));
  EXPECT_FALSE(find_lane_edges(returns_of([](double, double) { return 0.2; })));
  // bright ground beside the road
  EXPECT_FALSE(find_lane_edges(
      returns_of([](double, double across) { return std::abs(across) > 1.8 ? 0.6 : 0.1; })));
  // a line on one side
  EXPECT_FALSE(find_lane_edges(
      returns_of([](double, double across) { return is_line(across, 1.5) ? 0.6 : 0.1; })));
  // lines too far apart
  EXPECT_FALSE(find_lane_edges(returns_of(
      [](double, double across) { return is_line(std::abs(across), 2.9) ? 0.6 : 0.1; })));
}

}  // namespace
}  // namespace redrive
