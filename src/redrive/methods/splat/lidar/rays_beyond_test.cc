// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/lidar/rays_beyond.h"

#include <cmath>

#include <gtest/gtest.h>

#include "redrive/methods/splat/splat_scene_testing.h"

namespace redrive {
namespace {

/// A fence 5 m to the left, of which every fifth ray comes back, and a wall 12 m to the left.
struct FenceScene : SplatScene {
  std::vector<Eigen::Vector3f> fence, wall;

  FenceScene() {
    const int front =
        add_camera("FRONT", "opencv_pinhole", {60, 60, 39.5, 29.5, 0, 0, 0, 0, 0}, 80, 60);
    for (int n = 0; n < 3; ++n) {
      Rigid3d pose = Rigid3d::Identity();
      pose.translation() = Eigen::Vector3d(0.5 * n, 0, 1);
      add_view(front, pose, /*held_out=*/false);
    }
    finish();
    std::vector<MeasuredPoint> ends;
    for (int n = 0; n < 3; ++n)
      for (int azimuth = -100; azimuth <= 100; ++azimuth)
        for (int beam = -10; beam <= 10; ++beam) {
          const bool stops = (azimuth + 3 * beam + 1000) % 5 == 0;
          const float y = stops ? 5 : 12, x = y * std::tan(0.005f * float(azimuth)),
                      z = y * 0.01f * float(beam);
          const Eigen::Vector3f at(0.5f * float(n) + x, y, 1 + z);
          ends.push_back({at.cast<double>(), scene.frames[n].t_ns});
          (stops ? fence : wall).push_back(at);
        }
    lidar = returns_of(scene, ends);
    for (std::size_t n = 1; n <= 3; ++n) lidar.scan_ends.push_back({n * lidar.n / 3, 0, 0});
  }
};

TEST(RaysBeyond, MostRaysPassAFenceAndNoneAWall) {
  const FenceScene scene;
  ThreadPool pool(2);
  const auto mean = [&](const std::vector<Eigen::Vector3f>& points) {
    double sum = 0;
    for (const float share : shares_beyond(scene.scene, scene.lidar, points, pool)) {
      EXPECT_GE(share, 0);
      EXPECT_LE(share, 1);
      sum += double(share);
    }
    return sum / double(points.size());
  };
  EXPECT_GT(mean(scene.fence), 0.5);
  EXPECT_EQ(mean(scene.wall), 0);
  EXPECT_EQ(mean({{0, -7, 1}, {0, 300, 1}}), 0) << "where no ray looks";
}

}  // namespace
}  // namespace redrive
