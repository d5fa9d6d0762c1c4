// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/lidar/scan_windows.h"

#include <cmath>
#include <numbers>
#include <set>

#include <gtest/gtest.h>

#include "redrive/kernels/gaussian/gaussian_stages.h"
#include "redrive/methods/splat/splat_scene_testing.h"

namespace redrive {
namespace {

/// Two scans of 100 ms by a car that drives 10 m/s: each fires 8 rays around, the last of which is
/// lost, and one at a moving object.
struct TwoScans : SplatScene {
  static constexpr int kRays = 8;

  TwoScans() {
    add_camera("FRONT", "opencv_pinhole", {60, 60, 39.5, 29.5, 0, 0, 0, 0, 0}, 80, 60);
    for (int n = 0; n < 4; ++n) {
      Rigid3d pose = Rigid3d::Identity();
      pose.translation().x() = n;
      add_view(0, pose);
    }
    finish();
    lidar.sensors = {{Rigid3d(Eigen::Translation3d(0, 0, 2))}};
    std::vector<Eigen::Vector3f> directions;
    for (int scan = 0; scan < 2; ++scan) {
      for (int ray = 0; ray + 1 < kRays; ++ray) {
        directions.push_back(direction(ray));
        lidar.range_m.push_back(static_cast<float>(5 + ray));
        lidar.t_ns.push_back(t_ns(scan, ray));
        lidar.intensity.push_back(static_cast<std::uint16_t>(51 * (ray % 4)));
      }
      lidar.on_objects.push_back({7, t_ns(scan, 2), {0, 0, 0}, direction(2), 3, 255});
      lidar.lost.push_back({direction(kRays - 1), t_ns(scan, kRays - 1)});
      lidar.scan_ends.push_back({lidar.range_m.size(), lidar.on_objects.size(), lidar.lost.size()});
    }
    lidar.n = lidar.range_m.size();
    for (int k = 0; k < 3; ++k)
      for (const Eigen::Vector3f& d : directions) lidar.direction.push_back(d[k]);
  }
  static Eigen::Vector3f direction(int ray) {
    const float azimuth = 0.1f - 2 * std::numbers::pi_v<float> * float(ray) / kRays;
    return {std::cos(azimuth), std::sin(azimuth), 0};
  }
  static std::int64_t t_ns(int scan, int ray) { return 100'000'000ll * scan + 12'500'000ll * ray; }
};

TEST(ScanWindows, HaveEachRayOnceWhereItIsFired) {
  const TwoScans drive;
  const ScanWindows windows(drive.scene, drive.lidar, [](std::int64_t) { return true; });
  ASSERT_EQ(windows.size(), 8u) << "four of each scan";
  std::multiset<std::int64_t> times;
  int lost = 0, on_object = 0;
  for (std::size_t w = 0; w < windows.size(); ++w) {
    const ScanWindow window = windows[w];
    const std::size_t n = window.t_ns.size();
    ASSERT_GT(n, 1u);
    for (std::size_t i = 0; i < n; ++i) {
      times.insert(window.t_ns[i]);
      const int ray = static_cast<int>(window.t_ns[i] / 12'500'000 % TwoScans::kRays);
      EXPECT_NEAR(window.origin[i], 1e-8 * double(window.t_ns[i]), 1e-5) << "10 m/s";
      EXPECT_NEAR(window.origin[2 * n + i], 2, 1e-6);
      for (std::size_t k = 0; k < 3; ++k)
        EXPECT_NEAR(window.direction[k * n + i], TwoScans::direction(ray)[Eigen::Index(k)], 1e-6);
      // z of the axes is towards the rays of the window.
      const Eigen::Vector3d z = window.world_from_axes.col(2);
      EXPECT_GT(z.dot(TwoScans::direction(ray).cast<double>()), 0.7);
      if (window.log_range[i] == kernels::kNoRange) {
        ++lost;
        EXPECT_EQ(ray, TwoScans::kRays - 1);
      } else if (window.intensity[i] == 1) {
        ++on_object;
        EXPECT_NEAR(window.log_range[i], std::log(3), 1e-6);
      } else {
        EXPECT_NEAR(window.log_range[i], std::log(5 + ray), 1e-6);
        EXPECT_NEAR(window.intensity[i], 0.2 * (ray % 4), 1e-6);
      }
    }
  }
  EXPECT_EQ(times.size(), 18u);
  EXPECT_EQ(lost, 2);
  EXPECT_EQ(on_object, 2);
  EXPECT_NEAR(windows[0].world_from_axes.determinant(), 1, 1e-9);
}

TEST(ScanWindows, LeaveOutObjectsThatAreNotDrawn) {
  const TwoScans drive;
  const ScanWindows windows(drive.scene, drive.lidar, [](std::int64_t id) { return id != 7; });
  std::size_t rays = 0;
  for (std::size_t w = 0; w < windows.size(); ++w) rays += windows[w].t_ns.size();
  EXPECT_EQ(rays, 16u);
}

TEST(ScanWindows, LeaveOutLostRaysThatTheVehicleStops) {
  TwoScans drive;
  LidarReturns::Sensor& sensor = drive.lidar.sensors[0];
  sensor.body_from_sensor.rotate(Eigen::AngleAxisd(0.5, Eigen::Vector3d::UnitZ()));
  const Eigen::Vector3d lost = drive.lidar.lost[0].direction.cast<double>();
  sensor.blind.insert(BlindDirections::cell_of(sensor.body_from_sensor.linear() * lost));
  const ScanWindows windows(drive.scene, drive.lidar, [](std::int64_t) { return true; });
  std::size_t rays = 0;
  for (std::size_t w = 0; w < windows.size(); ++w) rays += windows[w].t_ns.size();
  EXPECT_EQ(rays, 16u);
}

TEST(ScanWindows, TakeTheStrongerReturnOfARay) {
  TwoScans drive;
  LidarReturns& lidar = drive.lidar;
  // The second ray of the first scan becomes a second return of the first.
  lidar.t_ns[1] = lidar.t_ns[0];
  for (int k = 0; k < 3; ++k) lidar.direction[k * lidar.n + 1] = lidar.direction[k * lidar.n];
  for (const bool second : {false, true}) {
    lidar.intensity[0] = second ? 10 : 90;
    lidar.intensity[1] = 50;
    const ScanWindows windows(drive.scene, lidar, [](std::int64_t) { return true; });
    const ScanWindow window = windows[0];
    ASSERT_EQ(window.t_ns.size(), 1u);
    EXPECT_NEAR(window.log_range[0], std::log(second ? 6 : 5), 1e-6);
  }
}

TEST(ScanWindows, OfAnotherLidarHaveItsPlaceAndGain) {
  TwoScans drive;
  LidarReturns& lidar = drive.lidar;
  lidar.sensors.push_back({Rigid3d(Eigen::Translation3d(0, 0, 3)), 0.5f});
  lidar.scan_ends[1].sensor = 1;
  const ScanWindows windows(drive.scene, lidar, [](std::int64_t) { return false; });
  ASSERT_EQ(windows.size(), 8u);
  for (const std::size_t w : {0, 4}) {
    const ScanWindow window = windows[w];
    const std::size_t n = window.t_ns.size();
    EXPECT_NEAR(window.origin[2 * n], w == 0 ? 2 : 3, 1e-6);
    // 51 of 153, which is below 255, or half of that.
    ASSERT_GT(n, 1u);
    EXPECT_NEAR(window.intensity[1], (w == 0 ? 1 : 2) * 51 / 255.0, 1e-6);
  }
}

TEST(ScanWindows, AScanOfOneTimeIsCutByAzimuth) {
  TwoScans drive;
  for (std::int64_t& t_ns : drive.lidar.t_ns) t_ns = 0;
  for (auto& lost : drive.lidar.lost) lost.t_ns = 0;
  const ScanWindows windows(drive.scene, drive.lidar, [](std::int64_t) { return false; });
  for (std::size_t w = 0; w < 4; ++w) EXPECT_EQ(windows[w].t_ns.size(), 2u) << w;
}

TEST(ScanWindows, PointCloudsHaveNone) {
  TwoScans drive;
  drive.lidar.scan_ends.clear();
  EXPECT_EQ(ScanWindows(drive.scene, drive.lidar, [](std::int64_t) { return true; }).size(), 0u);
}

}  // namespace
}  // namespace redrive
