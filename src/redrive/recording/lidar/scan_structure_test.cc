// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/lidar/scan_structure.h"

#include <cmath>

#include <gtest/gtest.h>

#include "redrive/math/angles.h"
#include "redrive/recording/lidar/spinning_testing.h"

namespace redrive {
namespace {

void expect_structure(const Spinning& sensor) {
  std::string why;
  const auto found = sensor.estimate(&why);
  ASSERT_TRUE(found) << why;
  ASSERT_EQ(found->sensor.beams.size(), 16u);
  EXPECT_EQ(found->sensor.azimuth_steps, 900);
  EXPECT_EQ(found->intensity_scale, 255);
  EXPECT_EQ(found->sensor.clockwise, sensor.clockwise);
  EXPECT_NEAR(found->sensor.rate_hz, sensor.rate_hz, 1e-3 * sensor.rate_hz);
  EXPECT_NEAR(found->second_returns, sensor.second, 0.02);
  EXPECT_GE(found->sensor.min_range_m, 5 - 1e-3);
  EXPECT_LE(found->sensor.max_range_m, 30 + 1e-3);
  for (int beam = 0; beam < Spinning::kBeams; ++beam) {
    EXPECT_NEAR(found->sensor.beams[beam].elevation_rad, Spinning::elevation_rad(beam), 2e-4)
        << beam;
    EXPECT_NEAR(found->sensor.beams[beam].azimuth_rad, Spinning::azimuth_rad(beam), 2e-3) << beam;
  }
}

TEST(ScanStructure, BeamsAreClustersOfElevations) { expect_structure({}); }

TEST(ScanStructure, TurnsEitherWayAtAnyRate) {
  expect_structure({.rate_hz = 20, .clockwise = false});
}

TEST(ScanStructure, RingsGiveBeamsWhoseElevationsAreNoisy) {
  constexpr double kNoise_rad = 0.05;  // more than the distance of two beams
  Spinning sensor{.noise_rad = kNoise_rad};
  std::string why;
  EXPECT_FALSE(sensor.estimate(&why));
  EXPECT_EQ(why, "elevations of its returns form no beams, and the format gives no rings");
  sensor.has_rings = true;
  const auto found = sensor.estimate(&why);
  ASSERT_TRUE(found);
  EXPECT_EQ(found->sensor.beams.size(), 16u);
  EXPECT_NEAR(found->residual_rad, kNoise_rad / std::sqrt(12), 0.1 * kNoise_rad);
}

TEST(ScanStructure, RingsOfFewReturnsAreNoBeams) {
  const Spinning sensor{.has_rings = true};
  std::vector<std::vector<LidarPoint>> scans = {sensor.scan(0)};
  std::size_t left = 10;  // returns of the beam in the middle
  std::erase_if(scans[0], [&](const LidarPoint& point) {
    return point.ring == 8 && (left == 0 || left-- == 0);
  });
  std::string why;
  const auto found = estimate_structure(scans, sensor.body_from_lidar, &why);
  ASSERT_TRUE(found) << why;
  ASSERT_EQ(found->sensor.beams.size(), 15u);
  for (int beam = 0; beam < 15; ++beam)
    EXPECT_NEAR(found->sensor.beams[beam].elevation_rad,
                Spinning::elevation_rad(beam < 7 ? beam : beam + 1), 2e-4);
}

TEST(ScanStructure, AScanOfOneTimeHasNoRate) {
  std::string why;
  const auto found = Spinning{.has_times = false}.estimate(&why);
  ASSERT_TRUE(found);
  EXPECT_EQ(found->sensor.beams.size(), 16u);
  EXPECT_EQ(found->sensor.rate_hz, 0);
  EXPECT_EQ(found->sensor.azimuth_steps, 900);
}

TEST(ScanStructure, RingsOfFewReturnsSayNothing) {
  std::vector<LidarPoint> points;
  for (int i = 0; i < 2000; ++i)
    points.push_back({.in_body_m = {10, 0.01f * static_cast<float>(i % 100), 0.001f * i},
                      .ring = static_cast<std::uint8_t>(i % 200)});
  const std::vector<std::vector<LidarPoint>> scans = {points};
  std::string why;
  EXPECT_FALSE(estimate_structure(scans, Rigid3d::Identity(), &why));
  EXPECT_EQ(why, "no ring of its scans has 20 returns");
}

TEST(ScanStructure, ReturnsBetweenTheBeamsAreAMisfit) {
  ScanStructure structure;
  EXPECT_FALSE(misfit(structure));
  for (const double elevation_deg : {-3, -2, -1, 5})
    structure.sensor.beams.push_back({.elevation_rad = kRadiansPerDegree * elevation_deg});
  structure.residual_rad = 0.49 * kRadiansPerDegree;
  EXPECT_FALSE(misfit(structure));
  structure.residual_rad = 0.51 * kRadiansPerDegree;
  EXPECT_EQ(misfit(structure),
            "its returns lie 0.510 degrees off the elevations of its beams, which are 1.000 apart: "
            "the extrinsics, or scans that are motion compensated?");
}

TEST(ScanStructure, FewReturnsSayNothing) {
  std::string why;
  EXPECT_FALSE(Spinning{.lost = 0.99}.estimate(&why));
  EXPECT_NE(why.find("have only"), std::string::npos) << why;
  EXPECT_FALSE(estimate_structure({}, Rigid3d::Identity(), &why));
}

}  // namespace
}  // namespace redrive
