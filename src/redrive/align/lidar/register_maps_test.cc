// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/lidar/register_maps.h"

#include <array>
#include <cmath>

#include <gtest/gtest.h>

#include "redrive/align/lidar/made_block_testing.h"
#include "redrive/base/rng.h"
#include "redrive/math/angles.h"

namespace redrive {
namespace {

using testing::MadeBlock;

PointMap in_body(const Rigid3d& world_from_body, const PointMap& in_world) {
  PointMap map;
  for (const Eigen::Vector3d& p : in_world)
    map.push_back(world_from_body.inverse(Eigen::Isometry) * p);
  return map;
}

TEST(RegisterMaps, FindsTheMotionFromMetresAway) {
  const MadeBlock block;
  const std::vector<FramePose> frames = testing::drive_around(1.1);
  const Rigid3d target = frames[5].global_from_body, source = frames[255].global_from_body;
  const PointMap first = in_body(target, block.seen_from(target.translation(), 1)),
                 second = in_body(source, block.seen_from(source.translation(), 2));
  const Rigid3d exact = target.inverse(Eigen::Isometry) * source;
  for (const auto& [forward_m, left_m, yaw_deg] :
       {std::array{0.0, 0.0, 0.0}, std::array{3.1, -2.2, 1.4}, std::array{-4.6, 4.3, -2.3}}) {
    Rigid3d error = Rigid3d::Identity();
    error.translation() = Eigen::Vector3d(forward_m, left_m, 0.7);
    error.linear() = so3_exp({0.002, -0.003, yaw_deg * kRadiansPerDegree});
    const MapRegistration found =
        register_maps(first, second, exact * error, 5, 3 * kRadiansPerDegree);
    EXPECT_EQ(found.doubt, "") << found.overlap << " " << found.upright;
    const Rigid3d left = exact.inverse(Eigen::Isometry) * found.target_from_source;
    EXPECT_LT(left.translation().norm(), 0.03);
    EXPECT_LT(so3_log(left.linear()).norm(), 0.05 * kRadiansPerDegree);
    EXPECT_LT(found.residual_m, 0.05);
    // The stated deviation covers the error and is not boundless.
    const double sigma_m = std::sqrt(found.covariance.diagonal().head(3).sum());
    EXPECT_LT(left.translation().norm(), 3 * sigma_m);
    EXPECT_LT(sigma_m, 0.1);
  }
}

TEST(RegisterMaps, DoubtsAnotherPlace) {
  const MadeBlock block;
  const std::vector<FramePose> frames = testing::drive_around(1.1);
  const Rigid3d target = frames[5].global_from_body;
  for (const int other : {60, 100, 140, 190}) {
    const Rigid3d source = frames[other].global_from_body;
    const MapRegistration found = register_maps(
        in_body(target, block.seen_from(target.translation(), 1)),
        in_body(source, block.seen_from(source.translation(), 2)), Rigid3d::Identity(), 5, 0.05);
    EXPECT_EQ(found.doubt, "their surfaces do not fit")
        << other << " " << found.overlap << " " << found.upright;
  }
  EXPECT_EQ(register_maps({}, {}, Rigid3d::Identity(), 5, 0.05).doubt, "there are no LiDAR points");
}

// Between two endless walls nothing tells how far along: that direction is stated as unknown.
TEST(RegisterMaps, StatesWhatTheSurfacesDoNotTell) {
  const auto street = [](std::uint64_t pass) {
    PointMap map;
    for (std::uint64_t i = 0; i < 30'000; ++i) {
      const std::uint64_t key = random_key(5, kStreamTest, pass);
      const auto at = [&](std::uint64_t k, double low, double high) {
        return low + (high - low) * random_unit(key, 3 * i + k);
      };
      if (i % 3 == 0)
        map.emplace_back(at(0, -40, 40), at(1, -7, 7), 0);
      else
        map.emplace_back(at(0, -40, 40), i % 3 == 1 ? 7.2 : -7.3, at(1, 0, 4));
    }
    return map;
  };
  Rigid3d guess = Rigid3d::Identity();
  guess.translation() = Eigen::Vector3d(0.2, 1.1, 0.3);
  const MapRegistration found = register_maps(street(1), street(2), guess, 3, 0.05);
  EXPECT_EQ(found.doubt, "") << found.upright;
  EXPECT_LT(std::abs(found.target_from_source.translation().y()), 0.02);
  EXPECT_LT(std::abs(found.target_from_source.translation().z()), 0.02);
  EXPECT_GT(found.covariance(0, 0), 1);
  EXPECT_LT(found.covariance(1, 1), 0.05 * 0.05);
  EXPECT_LT(found.covariance(2, 2), 0.05 * 0.05);
}

}  // namespace
}  // namespace redrive
