// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/lidar/lost_rays.h"

#include <algorithm>
#include <limits>

#include <gtest/gtest.h>

#include "redrive/recording/lidar/spinning_testing.h"

namespace redrive {
namespace {

constexpr double kStep_rad = 2 * std::numbers::pi / Spinning::kSteps;

class LostRaysOf : public ::testing::Test {
 protected:
  LostRays find(const Spinning& sensor, int number = 1) {
    truth_.clear();
    const std::vector<std::vector<LidarPoint>> scans = {sensor.scan(0), sensor.scan(1)};
    const auto structure = estimate_structure(scans, sensor.body_from_lidar, &why_);
    if (!structure) return {};
    points_ = sensor.scan(number, &truth_);
    return lost_rays(points_, sensor.body_from_lidar, *structure, &why_);
  }
  /// Expects the directions of the rays that were left out.
  void expect_found(const LostRays& found, double within_rad = 0.5 * kStep_rad) {
    EXPECT_EQ(why_, "");
    EXPECT_EQ(found.size(), truth_.size());
    EXPECT_EQ(found.size() + found.returned, Spinning::kBeams * Spinning::kSteps);
    EXPECT_TRUE(std::ranges::is_sorted(found.t_ns));
    std::size_t near = 0;
    for (const Eigen::Vector3d& ray : truth_)
      near += std::ranges::any_of(found.direction, [&](const Eigen::Vector3f& direction) {
        return (direction.cast<double>() - ray).norm() < within_rad;
      });
    EXPECT_EQ(near, truth_.size());
  }
  std::string why_;
  std::vector<Eigen::Vector3d> truth_;
  std::vector<LidarPoint> points_;
};

TEST_F(LostRaysOf, AreTheFiredOnesWithoutReturn) {
  expect_found(find({}));
  expect_found(find({.clockwise = false, .has_rings = true}));
  expect_found(find({.rate_hz = 20, .lost = 0.5, .has_rings = true}));
}

TEST_F(LostRaysOf, HaveTheTimesOfTheirColumns) {
  const Spinning sensor{.has_rings = true};
  const LostRays found = find(sensor);
  ASSERT_GT(found.size(), 1000u);
  for (std::size_t i = 0; i < found.size(); ++i) {
    const double azimuth = std::atan2(found.direction[i].y(), found.direction[i].x()),
                 turned = Spinning::azimuth_rad(found.beam[i]) - azimuth - 1,
                 share = turned / (2 * std::numbers::pi);
    EXPECT_NEAR(1e-9 * found.t_ns[i], (1 + share - std::floor(share)) / sensor.rate_hz, 4e-4);
  }
}

TEST_F(LostRaysOf, AScanOfOneTimeHaveItsTime) {
  const LostRays found = find({.has_times = false});
  EXPECT_EQ(why_, "");
  // Azimuths of beams are unknown without times, so each beam may end elsewhere.
  EXPECT_NEAR(found.size(), truth_.size(), 0.02 * truth_.size());
  for (const std::int64_t t_ns : found.t_ns) EXPECT_EQ(t_ns, 0);
}

TEST_F(LostRaysOf, AWholeBeamAndASectorAreFound) {
  const Spinning sensor{.lost = 0, .has_rings = true};
  const LostRays none = find(sensor);
  EXPECT_EQ(none.size(), 0u);
  std::string why;
  const auto structure = sensor.estimate(&why);
  ASSERT_TRUE(structure);
  std::vector<LidarPoint> points = points_;
  std::erase_if(points, [](const LidarPoint& point) { return point.ring == 3; });
  const LostRays beam = lost_rays(points, sensor.body_from_lidar, *structure);
  EXPECT_EQ(beam.size(), Spinning::kSteps);
  EXPECT_TRUE(std::ranges::all_of(beam.beam, [](int b) { return b == Spinning::kBeams - 1 - 3; }));

  // Upper beams see the sky in a half of the turn.
  points = points_;
  const auto middle = static_cast<std::ptrdiff_t>(points.size() / 2);
  points.erase(std::remove_if(points.begin() + middle, points.end(),
                              [](const LidarPoint& point) { return point.ring < 8; }),
               points.end());
  EXPECT_NEAR(lost_rays(points, sensor.body_from_lidar, *structure).size(),
              8.0 * Spinning::kSteps / 2, 30);
}

TEST_F(LostRaysOf, RingsMayBeNumberedAnewByEachScan) {
  const Spinning sensor{.has_rings = true};
  const LostRays found = find(sensor);
  std::string why;
  for (LidarPoint& point : points_) point.ring += 40;
  EXPECT_EQ(lost_rays(points_, sensor.body_from_lidar, *sensor.estimate(&why)).beam, found.beam);
}

TEST_F(LostRaysOf, StrayReturnsDoNotMatter) {
  const Spinning sensor{.has_rings = true};
  const LostRays found = find(sensor);
  std::string why;
  const ScanStructure structure = *sensor.estimate(&why);
  LidarPoint stray = points_.front();
  stray.t_ns += 40'000'000;
  points_.push_back(stray);
  EXPECT_EQ(lost_rays(points_, sensor.body_from_lidar, structure).size(), found.size());
  stray = points_.back();
  stray.in_body_m = sensor.body_from_lidar.translation().cast<float>();
  points_.push_back(stray);
  stray.in_body_m.x() = std::numeric_limits<float>::quiet_NaN();
  points_.push_back(stray);
  EXPECT_EQ(lost_rays(points_, sensor.body_from_lidar, structure).size(), found.size());
}

TEST_F(LostRaysOf, StepsMayJitter) {
  const LostRays found = find({.has_rings = true, .jitter = 0.4});
  EXPECT_EQ(why_, "");
  EXPECT_EQ(found.size() + found.returned, Spinning::kBeams * Spinning::kSteps);
  EXPECT_NEAR(found.size(), truth_.size(), 0.001 * truth_.size());
}

TEST_F(LostRaysOf, AStructureThatDoesNotFitSaysNothing) {
  EXPECT_EQ(find({.noise_rad = 0.1, .has_rings = true}).size(), 0u);
  EXPECT_NE(why_.find("degrees off the elevations of its beams"), std::string::npos) << why_;

  const Spinning sensor;
  std::string why;
  const ScanStructure structure = *sensor.estimate(&why);
  EXPECT_EQ(lost_rays({}, sensor.body_from_lidar, structure, &why).size(), 0u);
  EXPECT_EQ(why, "no ray has a return");

  ScanStructure other = structure;
  other.sensor.azimuth_steps = 0;
  EXPECT_EQ(lost_rays(sensor.scan(1), sensor.body_from_lidar, other, &why).size(), 0u);
  EXPECT_EQ(why, "the azimuth steps of its beams are unknown");

  std::vector<LidarPoint> points = sensor.scan(1);
  for (LidarPoint& point : points) point.t_ns *= 1000;
  EXPECT_EQ(lost_rays(points, sensor.body_from_lidar, structure, &why).size(), 0u);
  EXPECT_EQ(why, "times of its returns do not fit its rate of rotation");

  points = sensor.scan(1);
  for (LidarPoint& point : points) point.t_ns = -point.t_ns;
  EXPECT_EQ(lost_rays(points, sensor.body_from_lidar, structure, &why).size(), 0u);
  EXPECT_EQ(why, "times of its returns do not fit its rate of rotation");
}

TEST(LostRays, ReturnsWithoutARingAreAnotherSensors) {
  const Spinning spinning{.has_rings = true};
  const std::vector<std::vector<LidarPoint>> own = {spinning.scan(0), spinning.scan(1)};
  std::vector<std::vector<LidarPoint>> both = own;
  for (std::vector<LidarPoint>& scan : both)
    for (std::size_t i = 0; i < scan.size(); i += 6) {
      LidarPoint other = scan[i];
      other.ring = kNoRing;
      other.in_body_m.z() -= 1;
      scan.insert(scan.begin() + std::ptrdiff_t(i), other);
    }
  std::string why;
  const auto of_own = estimate_structure(own, spinning.body_from_lidar, &why),
             of_both = estimate_structure(both, spinning.body_from_lidar, &why);
  ASSERT_TRUE(of_own && of_both) << why;
  EXPECT_EQ(of_both->sensor.beams.size(), std::size_t(Spinning::kBeams));
  EXPECT_EQ(of_both->residual_rad, of_own->residual_rad);
  const LostRays lost = lost_rays(both[0], spinning.body_from_lidar, *of_both, &why),
                 lost_of_own = lost_rays(own[0], spinning.body_from_lidar, *of_own, &why);
  ASSERT_EQ(lost.size(), lost_of_own.size()) << why;
  EXPECT_EQ(lost.returned, lost_of_own.returned);
  EXPECT_GT(lost.size(), 100u);
}

}  // namespace
}  // namespace redrive
