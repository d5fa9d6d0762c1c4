// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/lidar/scan_structure.h"

#include <cmath>
#include <numbers>

#include <gtest/gtest.h>

#include "redrive/base/rng.h"
#include "redrive/math/angles.h"

namespace redrive {
namespace {

using Eigen::Vector3d;

/// A LiDAR of 16 beams, 2 degrees apart and in four columns of azimuths, that turns at `rate_hz`
/// with 900 firings a turn. Packets of three firings share a time.
struct Spinning {
  double rate_hz = 10, lost = 0.1, second = 0.2, noise_rad = 0;
  bool clockwise = true, has_rings = false, has_times = true;
  Rigid3d body_from_lidar =
      Eigen::Translation3d(1, 0.2, 1.7) * Rigid3d(Eigen::AngleAxisd(0.4, Vector3d(1, 2, 2) / 3));

  static constexpr int kBeams = 16, kSteps = 900;
  static double elevation_rad(int beam) { return kRadiansPerDegree * (2 * beam - 20); }
  static double azimuth_rad(int beam) { return kRadiansPerDegree * (2 * (beam % 4) - 3); }

  std::vector<LidarPoint> scan(int number) const {
    std::vector<LidarPoint> points;
    std::uint64_t drawn = 1'000'000u * static_cast<std::uint64_t>(number);
    const auto random = [&] { return static_cast<double>(mix64(++drawn) >> 11) * 0x1p-53; };
    for (int step = 0; step < kSteps; ++step)
      for (int beam = 0; beam < kBeams; ++beam) {
        if (random() < lost) continue;
        const double turn = 2 * std::numbers::pi * (step + 0.5) / kSteps + number,
                     azimuth = azimuth_rad(beam) + (clockwise ? -turn : turn),
                     elevation = elevation_rad(beam) + noise_rad * (random() - 0.5);
        const Vector3d direction(std::cos(elevation) * std::cos(azimuth),
                                 std::cos(elevation) * std::sin(azimuth), std::sin(elevation));
        for (const double range_m : {5 + 20 * random(), random() < second ? 30.0 : 0.0})
          if (range_m > 0)
            points.push_back(
                {.in_body_m = (body_from_lidar * Vector3d(range_m * direction)).cast<float>(),
                 .ring = static_cast<std::uint8_t>(has_rings ? kBeams - 1 - beam : kNoRing),
                 .t_ns = has_times
                             ? std::llround(1e9 * (number + step / 3 * 3.0 / kSteps) / rate_hz)
                             : 0});
      }
    return points;
  }
  std::optional<ScanStructure> estimate(std::string* why) const {
    const std::vector<std::vector<LidarPoint>> scans = {scan(0), scan(1)};
    return estimate_structure(scans, body_from_lidar, why);
  }
};

void expect_structure(const Spinning& sensor) {
  std::string why;
  const auto found = sensor.estimate(&why);
  ASSERT_TRUE(found) << why;
  ASSERT_EQ(found->beams.size(), 16u);
  EXPECT_EQ(found->azimuth_steps, 900);
  EXPECT_EQ(found->clockwise, sensor.clockwise);
  ASSERT_TRUE(found->rate_hz);
  EXPECT_NEAR(*found->rate_hz, sensor.rate_hz, 1e-3 * sensor.rate_hz);
  EXPECT_NEAR(found->second_returns, sensor.second, 0.02);
  EXPECT_GE(found->min_range_m, 5 - 1e-3);
  EXPECT_LE(found->max_range_m, 30 + 1e-3);
  for (int beam = 0; beam < Spinning::kBeams; ++beam) {
    EXPECT_NEAR(found->beams[beam].elevation_rad, Spinning::elevation_rad(beam), 2e-4) << beam;
    EXPECT_NEAR(found->beams[beam].azimuth_rad, Spinning::azimuth_rad(beam), 2e-3) << beam;
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
  EXPECT_EQ(found->beams.size(), 16u);
  EXPECT_NEAR(found->residual_rad, kNoise_rad / std::sqrt(12), 0.1 * kNoise_rad);
}

TEST(ScanStructure, AScanOfOneTimeHasNoRate) {
  std::string why;
  const auto found = Spinning{.has_times = false}.estimate(&why);
  ASSERT_TRUE(found);
  EXPECT_EQ(found->beams.size(), 16u);
  EXPECT_FALSE(found->rate_hz);
  EXPECT_EQ(found->azimuth_steps, 900);
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

TEST(ScanStructure, FewReturnsSayNothing) {
  std::string why;
  EXPECT_FALSE(Spinning{.lost = 0.99}.estimate(&why));
  EXPECT_NE(why.find("have only"), std::string::npos) << why;
  EXPECT_FALSE(estimate_structure({}, Rigid3d::Identity(), &why));
}

}  // namespace
}  // namespace redrive
