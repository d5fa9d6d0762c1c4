// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/lidar/ray_groups.h"

#include <cmath>
#include <numbers>
#include <vector>

#include <gtest/gtest.h>

#include "redrive/methods/splat/own_rays_testing.h"

namespace redrive {
namespace {

using Eigen::Vector3d;

struct MovingSensor : OwnRays {
  /// A revolution from behind, clockwise, from `from` on, with a motion of `motion_m`.
  void add_revolution(const Vector3d& from, const Vector3d& motion_m, double first_rad,
                      double elevation_rad) {
    constexpr int kSteps = 720;
    for (int i = 0; i < kSteps; ++i) {
      const double part = (i + 0.5) / kSteps, azimuth = first_rad - 2 * std::numbers::pi * part;
      origins.push_back(from + part * motion_m);
      directions.emplace_back(std::cos(elevation_rad) * std::cos(azimuth),
                              std::cos(elevation_rad) * std::sin(azimuth), std::sin(elevation_rad));
    }
  }
  std::vector<RayGroup> grouped() {
    ThreadPool pool(2);
    return group_rays(view(), pool);
  }
};

/// Expects every ray in one group, whose angles give its direction and whose line its origin.
void expect_rays(const MovingSensor& sensor, const std::vector<RayGroup>& groups) {
  std::vector<int> times(sensor.origins.size());
  for (const RayGroup& group : groups)
    for (std::size_t k = 0; k < group.rays.size(); ++k) {
      const int ray = group.rays[k];
      ++times[ray];
      const double azimuth = group.azimuth[k], elevation = group.elevation[k];
      EXPECT_LE(std::abs(azimuth), 0.79);
      EXPECT_LE(std::abs(elevation), 0.98);
      const Vector3d in_axes(std::cos(elevation) * std::sin(azimuth), std::sin(elevation),
                             std::cos(elevation) * std::cos(azimuth));
      EXPECT_LT((group.world_from_axes * in_axes - sensor.directions[ray]).norm(), 1e-6);
      EXPECT_LT((group.origin_at(azimuth) - sensor.origins[ray]).cwiseAbs().maxCoeff(),
                kOffTrack_m + 1e-5);
    }
  for (const int n : times) EXPECT_EQ(n, 1);
}

TEST(RayGroups, ASensorAtRestHasAGroupForEachSide) {
  MovingSensor sensor;
  sensor.add_revolution({100, 2, 3}, {0, 0, 0}, std::numbers::pi, 0.1);
  const std::vector<RayGroup> groups = sensor.grouped();
  EXPECT_EQ(groups.size(), 4u);
  expect_rays(sensor, groups);
}

// The first and the last rays of a turn are neighbours with origins 1.5 m apart.
TEST(RayGroups, TheEndOfATurnIsNotMixedWithItsBegin) {
  MovingSensor sensor;
  sensor.add_revolution({100, 2, 3}, {1.5, 0.2, 0}, std::numbers::pi + 0.3, 0.1);
  const std::vector<RayGroup> groups = sensor.grouped();
  EXPECT_EQ(groups.size(), 5u);
  expect_rays(sensor, groups);
  for (const RayGroup& group : groups)
    for (std::size_t k = 0; k < group.rays.size(); ++k)
      EXPECT_LT((group.origin_at(group.azimuth[k]) - sensor.origins[group.rays[k]]).norm(), 1e-4);
}

// Two turns of a sensor at rest, 0.1 s each: only times tell them apart.
TEST(RayGroups, TurnsAreToldApartByTime) {
  MovingSensor sensor;
  for (int turn = 0; turn < 2; ++turn)
    sensor.add_revolution({100, 2, 3}, {0, 0, 0}, std::numbers::pi * 0.75, 0.1);
  std::vector<std::int64_t> t_ns;
  for (std::size_t i = 0; i < sensor.origins.size(); ++i)
    t_ns.push_back(1'600'000'000'000'000'000 + static_cast<std::int64_t>(i) * 138'889);
  kernels::Rays rays = sensor.view();
  rays.t_ns = t_ns;
  ThreadPool pool(2);
  const std::vector<RayGroup> groups = group_rays(rays, pool);
  EXPECT_EQ(groups.size(), 8u);
  expect_rays(sensor, groups);
  for (const RayGroup& group : groups)
    for (std::size_t k = 0; k < group.rays.size(); ++k)
      EXPECT_NEAR(double(group.time_at(group.azimuth[k]) - t_ns[group.rays[k]]), 0, 2000);
}

TEST(RayGroups, SensorsThatTurnTogetherAreToldApart) {
  MovingSensor sensor;
  sensor.add_revolution({0, 0, 1.5}, {1, 0, 0}, std::numbers::pi, 0.1);
  sensor.add_revolution({0, 0, 1.7}, {1, 0, 0}, 0, -0.1);
  const std::vector<RayGroup> groups = sensor.grouped();
  EXPECT_LE(groups.size(), 12u);  // two for each side, four where one of them begins and ends
  expect_rays(sensor, groups);
}

TEST(RayGroups, AnyOriginsAndDirectionsFindAGroup) {
  MovingSensor sensor;
  for (int i = 0; i < 300; ++i) {
    sensor.origins.emplace_back(std::sin(i), std::sin(2.3 * i), 0.1 * std::sin(1.7 * i));
    sensor.directions.push_back(
        Vector3d(std::sin(3.1 * i), std::sin(4.7 * i), std::sin(5.3 * i)).normalized());
  }
  sensor.directions[0] = {0, 0, 1};
  sensor.directions[1] = {0, 0, -1};
  expect_rays(sensor, sensor.grouped());
  EXPECT_TRUE(MovingSensor().grouped().empty());
}

}  // namespace
}  // namespace redrive
