// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/lidar/cloud_returns.h"

#include <cmath>

#include <gtest/gtest.h>

namespace redrive {
namespace {

/// The second camera is turned.
const std::vector<CloudOrigin> kOrigins{
    {Rigid3d(Eigen::Translation3d(0, 0, 1)), 100},
    {Eigen::Translation3d(10, 0, 1) * Rigid3d(Eigen::AngleAxisd(0.3, Eigen::Vector3d(1, 2, 2) / 3)),
     200}};

LidarReturns returns_of(const std::vector<Eigen::Vector3d>& points) {
  ThreadPool pool(2);
  std::vector<CloudPoint> cloud;
  for (const Eigen::Vector3d& point : points) cloud.push_back({point});
  return cloud_returns(cloud, kOrigins, 0.5f, pool);
}

TEST(CloudReturns, AssignsEachPointToTheNearestOrigin) {
  const std::vector<Eigen::Vector3d> points{{-3, 4, 1}, {14, 3, 1}, {4.9, 5, 1}, {5.1, 5, 1}};
  const LidarReturns returns = returns_of(points);
  ASSERT_EQ(returns.n, 4u);
  EXPECT_EQ(returns.hidden, 0u);
  EXPECT_EQ(returns.t_ns, (std::vector<std::int64_t>{100, 200, 100, 200}));
  EXPECT_FLOAT_EQ(returns.range_m[0], 5);
  EXPECT_FLOAT_EQ(returns.range_m[1], 5);
  for (std::size_t i = 0; i < 4; ++i)
    EXPECT_LT((kOrigins[i % 2].world_from_sensor * returns.in_sensor(i) - points[i]).norm(), 2e-6);
}

TEST(CloudReturns, HidesOccludedPoints) {
  // A wall 4 m to the left with another one behind it, and the first one's own depth: 0.1 m.
  const LidarReturns returns =
      returns_of({{0, 4, 1}, {0.01, 8, 1}, {0.005, 4.1, 1}, {0, 8, 1}, {0, -8, 1}});
  ASSERT_EQ(returns.n, 3u);
  EXPECT_EQ(returns.hidden, 2u);
  EXPECT_FLOAT_EQ(returns.range_m[0], 4);
  EXPECT_NEAR(returns.range_m[1], 4.1, 1e-4);
  EXPECT_FLOAT_EQ(returns.range_m[2], 8) << "unoccluded on the other side";
}

TEST(CloudReturns, KeepsPointsADegreeApart) {
  EXPECT_EQ(returns_of({{0, 4, 1}, {8 * 0.018, 8, 1}}).n, 2u);
}

TEST(CloudReturns, DropsPointsAtTheCamera) {
  const LidarReturns returns = returns_of({{0, 0, 1}, {0.1, 0.1, 1}, {0, 2, 1}});
  ASSERT_EQ(returns.n, 1u);
  EXPECT_FLOAT_EQ(returns.range_m[0], 2);
}

TEST(CloudReturns, KeepsPointsWithTheOriginThatSeesThem) {
  ThreadPool pool(1);
  const LidarReturns returns =
      cloud_returns(std::vector<CloudPoint>{{{0, 4, 1}, 1}, {{10, 0.1, 1}, 1}, {{10, 8, 1}, 1}},
                    kOrigins, 0.5f, pool);
  ASSERT_EQ(returns.n, 3u) << "near and behind others";
  EXPECT_EQ(returns.t_ns, (std::vector<std::int64_t>{200, 200, 200}));
  EXPECT_FLOAT_EQ(returns.range_m[0], std::sqrt(116.0f));
}

TEST(CloudReturns, AcceptsEmptyClouds) { EXPECT_EQ(returns_of({}).n, 0u); }

}  // namespace
}  // namespace redrive
