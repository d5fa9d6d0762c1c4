// SPDX-License-Identifier: Apache-2.0
#include "redrive/render/block_way.h"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>

#include "redrive/base/rng.h"

namespace redrive {
namespace {

using Points = std::vector<Eigen::Vector3d>;

/// Frames each metre along x.
Points straight(int frames) {
  Points points;
  for (int i = 0; i < frames; ++i) points.emplace_back(i, 0, 0);
  return points;
}

TEST(BlockWay, OneBlockAwayFromBordersAndTwoAround) {
  const std::size_t last[] = {19, 39};
  const BlockWay way(straight(40), last);
  const auto weights_at = [&](double x) { return way.weights(way.place({x, 1.5, -0.3})); };
  EXPECT_EQ(way.end_m(0), 19.5);
  EXPECT_EQ(way.start_m(1), 19.5);
  EXPECT_EQ(way.end_m(1), 39);
  for (const double x : {-5.0, 0.0, 10.0, 19.5 - kSeam_m / 2}) {
    ASSERT_EQ(weights_at(x).size(), 1u) << x;
    EXPECT_EQ(weights_at(x)[0].block, 0) << x;
  }
  for (const double x : {19.5 + kSeam_m / 2, 30.0, 50.0}) {
    ASSERT_EQ(weights_at(x).size(), 1u) << x;
    EXPECT_EQ(weights_at(x)[0].block, 1) << x;
  }
  for (const double u : {0.25, 0.5, 0.75}) {
    const auto both = weights_at(19.5 + (u - 0.5) * kSeam_m);
    ASSERT_EQ(both.size(), 2u) << u;
    EXPECT_EQ(both[0].block, 0);
    EXPECT_EQ(both[1].block, 1);
    EXPECT_NEAR(both[1].weight, 3 * u * u - 2 * u * u * u, 1e-9);
    EXPECT_NEAR(both[0].weight + both[1].weight, 1, 1e-15);
  }
  // The derivative is continuous where a block joins in.
  const double step = 1e-4, begin = 19.5 - kSeam_m / 2;
  EXPECT_LT(weights_at(begin + step)[1].weight / step, 1e-3);
}

TEST(BlockWay, ThePassWhoseFrameIsNearerCounts) {
  Points points = straight(30);
  for (int i = 29; i >= 0; --i) points.emplace_back(i, 4, 0);
  const std::size_t last[] = {29, 59};
  const BlockWay way(points, last);
  EXPECT_EQ(way.block_at(way.place({10.3, 1.9, 0})), 0);
  EXPECT_EQ(way.block_at(way.place({10.3, 2.1, 0})), 1);
  EXPECT_EQ(way.place({10, 1.9, 0}).frame, 10u);
  EXPECT_EQ(way.place({10, 2.1, 0}).frame, 49u);
  EXPECT_NEAR(way.place({10.25, 2.1, 0}).along_m, 29 + 4 + 18.75, 1e-9);
}

TEST(BlockWay, SeamsOfShortCoresDoNotMeet) {
  const std::size_t last[] = {1, 5, 7};
  const BlockWay way(straight(8), last);  // cores of 1.5, 4 and 1.5 m, seams of 0.75 m
  for (double x = 0; x <= 7; x += 0.01) {
    const auto weights = way.weights(way.place({x, 0, 0}));
    ASSERT_LE(weights.size(), 2u);
    const double to_border_m = std::min(std::abs(x - 1.5), std::abs(x - 5.5));
    if (std::abs(to_border_m - 0.375) > 0.005) {
      EXPECT_EQ(weights.size(), to_border_m < 0.375 ? 2u : 1u) << x;
    }
  }
}

TEST(BlockWay, ACarMayStandAtABorder) {
  Points points = straight(20);
  points.insert(points.begin() + 10, 50, points[10]);
  const std::size_t last[] = {30, 69};
  const BlockWay way(points, last);
  EXPECT_EQ(way.end_m(0), 10);
  const auto weights = way.weights(way.place({10, 2, 0}));
  ASSERT_EQ(weights.size(), 2u);
  EXPECT_NEAR(weights[1].weight, 0.5, 1e-12);
  EXPECT_EQ(way.block_of_frame(30), 0);
  EXPECT_EQ(way.block_of_frame(31), 1);
}

TEST(BlockWay, FindsTheNearestFrameOfAll) {
  Points points{Eigen::Vector3d::Zero()};
  const auto random = [](std::uint64_t i) { return 2 * random_unit(7, i) - 1; };
  for (std::uint64_t i = 1; i < 333; ++i)
    points.push_back(points.back() +
                     Eigen::Vector3d(random(3 * i), random(3 * i + 1), random(3 * i + 2)));
  const std::size_t last[] = {332};
  const BlockWay way(points, last);
  for (std::uint64_t i = 0; i < 200; ++i) {
    const Eigen::Vector3d at =
        10 * Eigen::Vector3d(random(5000 + 3 * i), random(5001 + 3 * i), random(5002 + 3 * i));
    double nearest = std::numeric_limits<double>::infinity();
    for (const Eigen::Vector3d& point : points) nearest = std::min(nearest, (at - point).norm());
    EXPECT_EQ((points[way.place(at).frame] - at).norm(), nearest);
  }
}

}  // namespace
}  // namespace redrive
