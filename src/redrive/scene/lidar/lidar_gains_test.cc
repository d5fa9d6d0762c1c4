// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/lidar/lidar_gains.h"

#include <algorithm>
#include <array>
#include <cmath>

#include <gtest/gtest.h>

#include "redrive/math/angles.h"
#include "redrive/scene/scene_testing.h"

namespace redrive {
namespace {

// Four beams that scale intensities differently and see the same spots.
TEST(LidarGains, OfBeamsFollowFromWhatOthersSee) {
  const TemporaryFolder folder;
  const Recording recording = make_test_recording(folder.path, 3);
  constexpr std::array kGains = {0.6, 1.0, 1.2, 1.1};
  constexpr std::size_t kSpots = 400;
  LidarReturns returns;
  std::vector<float> z;
  for (std::size_t spot = 0; spot < kSpots; ++spot)
    for (std::size_t k = 0; k < 16; ++k) {
      const auto ring = static_cast<std::uint8_t>(k % 4);
      returns.range_m.push_back(5.1f + 0.4f * static_cast<float>(spot));
      z.push_back(0.001f + 1e-5f * static_cast<float>(ring));  // not on a voxel's border
      returns.t_ns.push_back(recording.frames[1].t_ns);
      returns.ring.push_back(ring);
      returns.intensity.push_back(static_cast<std::uint16_t>(1000 * (1 + spot % 7) * kGains[ring]));
    }
  returns.n = returns.range_m.size();
  returns.direction.assign(3 * returns.n, 0);
  std::fill_n(returns.direction.begin(), returns.n, 1.0f);
  std::fill_n(returns.direction.begin() + std::ptrdiff_t(returns.n), returns.n, 0.001f);
  std::ranges::copy(z, returns.direction.begin() + std::ptrdiff_t(2 * returns.n));
  returns.scan_ends = {{returns.n, 0, 0, 0}};
  const Scene scene = make_scene(recording, {});
  ThreadPool pool(1);
  const std::vector<BeamGain> beams = estimate_gains(scene, returns, pool)[0].beams;
  ASSERT_EQ(beams.size(), 4u);
  for (std::size_t r = 0; r < 4; ++r) {
    EXPECT_NEAR(beams[r].gain / beams[1].gain, kGains[r], 0.01) << r;
    EXPECT_NEAR(beams[r].elevation_rad, 0.001 + 1e-5 * double(r), 1e-6);
  }
  double log_sum = 0;
  for (const BeamGain& beam : beams) log_sum += std::log(beam.gain);
  EXPECT_NEAR(log_sum, 0, 1e-5);
  // With them, all beams measure the same.
  returns.sensors[0].beam_gains = beams;
  const std::vector<float> full = returns.full_intensities();
  EXPECT_NEAR(returns.intensity_of(0, full), returns.intensity_of(2, full), 0.002f);
  // Few returns do not tell, nor does a single beam.
  returns.ring.assign(returns.n, 2);
  EXPECT_TRUE(estimate_gains(scene, returns, pool)[0].beams.empty());
}

// The vehicle stops rays ahead, and returns some to the left; behind, every second ray is lost.
TEST(LidarGains, DirectionsInWhichNothingReturnsAreBlind) {
  const TemporaryFolder folder;
  const Recording recording = make_test_recording(folder.path, 30);
  const Eigen::Vector3d steep(1, 0, -0.3), flat(1, 0, -0.05);
  const auto turned = [](const Eigen::Vector3d& ray, double degrees) {
    return Eigen::Vector3d(
        Eigen::AngleAxisd(kRadiansPerDegree * degrees, Eigen::Vector3d::UnitZ()) *
        ray.normalized());
  };
  LidarReturns returns;
  returns.sensors[0].body_from_sensor.linear() =
      Eigen::AngleAxisd(kRadiansPerDegree * 90, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  const Eigen::Matrix3d sensor_from_body = returns.sensors[0].body_from_sensor.linear().transpose();
  std::vector<Eigen::Vector3d> back;
  for (int i = 0; i < 25; ++i) {
    for (const Eigen::Vector3d& ray : {steep, flat})
      returns.lost.push_back({(sensor_from_body * turned(ray, 0.5)).cast<float>(), 0});
    returns.sensors[0].on_ego.push_back((sensor_from_body * turned(steep, 90.5)).cast<float>());
    const Eigen::Vector3d behind = sensor_from_body * turned(steep, 178.5);
    if (i % 2)
      back.push_back(behind);
    else
      returns.lost.push_back({behind.cast<float>(), 0});
  }
  for (int i = 0; i < 5; ++i)  // too few
    returns.lost.push_back({(sensor_from_body * turned(steep, 45.5)).cast<float>(), 0});
  returns.n = back.size();
  for (int axis = 0; axis < 3; ++axis)
    for (const Eigen::Vector3d& ray : back) returns.direction.push_back(float(ray[axis]));
  returns.range_m.assign(returns.n, 5);
  returns.t_ns.assign(returns.n, recording.frames[1].t_ns);
  returns.intensity.assign(returns.n, 100);
  returns.scan_ends = {{returns.n, 0, returns.lost.size(), 0}};
  ThreadPool pool(1);
  const BlindDirections blind = estimate_gains(make_scene(recording, {}), returns, pool)[0].blind;
  EXPECT_EQ(blind.cells(), 2u);
  EXPECT_TRUE(blind.contains(turned(steep, 0.5)));
  EXPECT_TRUE(blind.contains(turned(steep, 90.5)));
  EXPECT_EQ(blind.runs().size(), 2u);
  EXPECT_EQ(blind.runs()[0][1], 1u);
  // A parked car cannot tell itself from what stands beside it.
  const TemporaryFolder other;
  const Recording parked = make_test_recording(other.path, 2);
  EXPECT_TRUE(estimate_gains(make_scene(parked, {}), returns, pool)[0].blind.empty());
}

TEST(LidarGains, MeansAreGeometric) {
  EXPECT_TRUE(mean_gains({}).empty());
  EXPECT_TRUE(mean_gains({{}, {}}).empty());
  std::vector<std::vector<LidarGains>> estimates = {
      {{1, {{0.1f, 2}}}, {4, {}}}, {}, {{1, {{0.3f, 0.5f}, {0.4f, 3}}}, {9, {}}}};
  estimates[0][0].blind.insert(5);
  for (const std::size_t k : {0, 2}) estimates[k][0].blind.insert(6);
  const std::vector<LidarGains> mean = mean_gains(estimates);
  ASSERT_EQ(mean.size(), 2u);
  EXPECT_FLOAT_EQ(mean[1].gain, 6);
  ASSERT_EQ(mean[0].beams.size(), 2u);
  EXPECT_FLOAT_EQ(mean[0].beams[0].gain, 1);
  EXPECT_FLOAT_EQ(mean[0].beams[0].elevation_rad, 0.2f);
  EXPECT_FLOAT_EQ(mean[0].beams[1].gain, 3) << "one estimate alone lists it";
  EXPECT_EQ(mean[0].blind.runs(), (std::vector<BlindDirections::Run>{{6, 1}}));
}

}  // namespace
}  // namespace redrive
