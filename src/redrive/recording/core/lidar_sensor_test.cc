// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/core/lidar_sensor.h"

#include <algorithm>
#include <cmath>
#include <set>

#include <gmock/gmock.h>

#include "redrive/math/angles.h"

namespace redrive {
namespace {

using ::testing::DoubleNear;
using ::testing::ElementsAre;
using ::testing::Pointwise;

std::vector<double> elevations_deg(const char* text) {
  std::vector<double> elevations;
  const auto sensor = parse_lidar_sensor(text);
  if (!sensor) return elevations;
  for (const LidarBeam& beam : sensor->beams)
    elevations.push_back(kDegreesPerRadian * beam.elevation_rad);
  return elevations;
}

auto near(const std::vector<double>& values) { return Pointwise(DoubleNear(1e-12), values); }

TEST(LidarBeams, AreAListOrEvenlySpaced) {
  EXPECT_THAT(elevations_deg("3:-24:2"), near({-24, -11, 2}));
  EXPECT_THAT(elevations_deg("7,-1.5,0"), near({-1.5, 0, 7}));
  EXPECT_THAT(elevations_deg("5.0"), near({5}));
  EXPECT_THAT(elevations_deg("-5"), near({-5}));
  EXPECT_EQ(elevations_deg("255:-90:90").size(), 255u);
  for (const char* text :
       {"",      "a",       "1,",          ",1",      "3:-24",     "3:-24:2:1", "1",
        "0",     "256",     "99999999999", "1:-24:2", "2.5:-24:2", "256:-24:2", "3:2:-24",
        "3:2:2", "3:-91:2", "1,91",        "nan",     "1,inf",     "1 2",       "recorded"})
    EXPECT_FALSE(parse_lidar_sensor(text)) << text;
}

TEST(LidarBeams, AreAsUsualSensorsHaveThemWhereOnlyTheirNumberIsGiven) {
  EXPECT_EQ(elevations_deg("64"), elevations_deg("64:-24.8:2"));
  EXPECT_EQ(elevations_deg("16"), elevations_deg("16:-15:15"));
  EXPECT_EQ(elevations_deg("32"), elevations_deg("32:-30.67:10.67"));
  EXPECT_EQ(elevations_deg("128"), elevations_deg("128:-25:15"));
}

// Eight steps, clockwise from behind by the left: the frame's time is when the sensor looks ahead.
TEST(LidarSensor, TurnsAndLooksAheadAtTheFramesTime) {
  LidarSensor lidar;
  lidar.beams = {{-M_PI / 6, 0.01}, {0, -0.01}};
  lidar.azimuth_steps = 8;
  lidar.rate_hz = 20;
  for (const bool clockwise : {true, false}) {
    lidar.clockwise = clockwise;
    const LidarFirings firings = lidar.revolution(1'000'000'000);
    ASSERT_EQ(firings.size(), 16u);
    ASSERT_EQ(firings.direction.size(), 16u);
    for (std::size_t i = 0; i < 16; ++i) {
      const int step = static_cast<int>(i / 2);
      EXPECT_EQ(firings.t_ns[i], 1'000'000'000 + (2 * step - 7) * 3'125'000) << "50 ms, 8 steps";
      EXPECT_EQ(firings.ring[i], i % 2);
      EXPECT_NEAR(firings.direction[i].norm(), 1, 1e-15);
      EXPECT_NEAR(firings.direction[i].z(), i % 2 ? 0 : -0.5, 1e-15);
      const double azimuth = std::atan2(firings.direction[i].y(), firings.direction[i].x()),
                   turned = kRadiansPerDegree * (157.5 - 45 * step);
      EXPECT_NEAR(azimuth, (clockwise ? turned : -turned) + (i % 2 ? -0.01 : 0.01), 1e-12);
    }
  }
  lidar.rate_hz = 0;
  for (const std::int64_t t_ns : lidar.revolution(5).t_ns) EXPECT_EQ(t_ns, 5);
}

TEST(RaisedReturn, HasAnotherElevation) {
  Rigid3d body_from_sensor(Eigen::Translation3d(1, 0.2, 1.8));
  body_from_sensor.linear() =
      Eigen::AngleAxisd(0.4, Eigen::Vector3d(0.2, -0.3, 1).normalized()).matrix();
  for (const double elevation_rad : {-1.2, -0.1, 0.0, 0.3})
    for (const double azimuth_rad : {0.0, 2.5, -1.0}) {
      const auto in_body = [&](double raised_rad) -> Eigen::Vector3d {
        return body_from_sensor * (20 * beam_direction(elevation_rad + raised_rad, azimuth_rad));
      };
      const RaisedReturn point(body_from_sensor, in_body(0));
      for (const double angle_rad : {-0.02, 0.0, 0.01}) {
        EXPECT_LT((point.at(angle_rad) - in_body(angle_rad)).norm(), 1e-12);
        const Eigen::Vector3d slope =
            (in_body(angle_rad + 1e-6) - in_body(angle_rad - 1e-6)) / 2e-6;
        EXPECT_LT((point.slope(angle_rad) - slope).norm(), 1e-7);
      }
    }
}

TEST(LidarSensor, APatternIsFiredAsItStands) {
  LidarSensor lidar;
  lidar.azimuth_steps = 0;
  lidar.pattern = {{{1, 0, 0}, 0.25, 4}, {{0, 1, 0}, 0.75, 2}};
  const LidarFirings firings = lidar.revolution(0);
  EXPECT_THAT(firings.t_ns, ElementsAre(-25'000'000, 25'000'000));
  EXPECT_THAT(firings.ring, ElementsAre(4, 2));
  EXPECT_EQ(firings.direction[1], Eigen::Vector3d(0, 1, 0));
}

// Figures of the data sheets.
TEST(KnownLidars, HaveTheBeamsOfTheirNames) {
  const auto expect = [](const char* name, std::size_t beams, double low, double high, int steps) {
    const std::vector<double> elevations = elevations_deg(name);
    ASSERT_EQ(elevations.size(), beams) << name;
    EXPECT_TRUE(std::ranges::is_sorted(elevations)) << name;
    EXPECT_EQ(std::set(elevations.begin(), elevations.end()).size(), beams) << name;
    EXPECT_NEAR(elevations.front(), low, 1e-9) << name;
    EXPECT_NEAR(elevations.back(), high, 1e-9) << name;
    EXPECT_EQ(parse_lidar_sensor(name)->azimuth_steps, steps) << name;
  };
  expect("vlp-16", 16, -15, 15, 1808);
  expect("hdl-32e", 32, -30.67, 10.67, 2170);
  expect("hdl-64e", 64, -24.33, 2, 2083);
  expect("vls-128", 128, -25, 15, 1876);
  expect("os1-64", 64, -22.5, 22.5, 1024);
  expect("os1-128", 128, -22.5, 22.5, 1024);
  expect("pandar64", 64, -24.897, 14.882, 1800);
  expect("pandar128", 128, -25, 14.436, 1800);
  const auto m1 = parse_lidar_sensor("rs-lidar-m1");
  ASSERT_TRUE(m1);
  EXPECT_EQ(m1->rate_hz * static_cast<double>(m1->pattern.size()), 750'000) << "points a second";
  EXPECT_NEAR(m1->pattern.front().direction.z(), std::sin(12.4 * kRadiansPerDegree), 1e-12);
  const auto at128 = parse_lidar_sensor("at128");
  ASSERT_EQ(at128->pattern.size(), 1200u * 128);
  const LidarPulse &first = at128->pattern[127], &last = at128->pattern.back();
  EXPECT_TRUE(std::ranges::is_sorted(at128->pattern, {}, &LidarPulse::at));
  const Eigen::Vector3d lowest =
      beam_direction(-12.5 * kRadiansPerDegree, 59.95 * kRadiansPerDegree);
  EXPECT_LT((first.direction - lowest).norm(), 1e-12);
  EXPECT_EQ(first.ring, 0);
  EXPECT_NEAR(last.direction.y(), -lowest.y(), 1e-12);
}

}  // namespace
}  // namespace redrive
