// SPDX-License-Identifier: Apache-2.0
#include "redrive/rays/lidar_sampler.h"

#include <map>

#include <gtest/gtest.h>

namespace redrive {
namespace {

LidarReturns returns(std::size_t n) {
  LidarReturns r;
  r.n = n;
  for (std::size_t k = 0; k < 3; ++k)
    for (std::size_t i = 0; i < n; ++i) r.direction.push_back(static_cast<float>(k == i % 3));
  for (std::size_t i = 0; i < n; ++i) {
    r.range_m.push_back(static_cast<float>(1 + i));
    r.t_ns.push_back(static_cast<std::int64_t>(i));
  }
  r.sensors = {{Rigid3d(Eigen::Translation3d(1000, 2000, 3000))}};
  return r;
}

/// The body drives 1 m per nanosecond.
Scene driving() {
  Scene scene;
  scene.add_frame({0, 0, Rigid3d::Identity()});
  scene.add_frame({1, 1000, Rigid3d(Eigen::Translation3d(1000, 0, 0))});
  return scene;
}

TEST(LidarSampler, VisitsEachReturnOncePerEpoch) {
  const LidarReturns r = returns(60);
  const Scene scene = driving();
  const LidarSampler sampler(r, scene, 5);
  RayBatch batch;
  std::map<float, int> drawn;
  bool in_order = true;
  for (int step = 0; step < 8; ++step) {  // 8 x 15: each return twice
    sampler.gather(step, 15, &batch);
    ASSERT_EQ(batch.n, 15);
    for (int i = 0; i < 15; ++i) {
      const float range = batch.range_m[i];
      ++drawn[range];
      in_order = in_order && range == 1 + static_cast<float>((15 * step + i) % 60);
      const int k = static_cast<int>(range) - 1;
      for (int d = 0; d < 3; ++d) {
        EXPECT_FLOAT_EQ(batch.origin[d * 15 + i], static_cast<float>(1000 * (d + 1) + (d ? 0 : k)));
        EXPECT_EQ(batch.direction[d * 15 + i], d == k % 3);
      }
      EXPECT_GT(batch.pixel_angle[i], 0);
    }
    if (step % 4 == 3) {
      EXPECT_EQ(drawn.size(), 60u);
    }
    for (const auto& [range, times] : drawn) EXPECT_LE(times, step < 4 ? 1 : 2);
  }
  EXPECT_FALSE(in_order) << "not shuffled";
}

TEST(LidarSampler, IsAFunctionOfSeedAndStep) {
  const LidarReturns r = returns(1000);
  const Scene scene = driving();
  RayBatch a, b, c;
  LidarSampler(r, scene, 5).gather(3, 64, &a);
  LidarSampler(r, scene, 5).gather(3, 64, &b);
  LidarSampler(r, scene, 6).gather(3, 64, &c);
  EXPECT_EQ(a.range_m, b.range_m);
  EXPECT_NE(a.range_m, c.range_m);
}

// The pose of frame 1 is changed, so returns between it and frame 0 move by a fraction, and those
// at frame 0 do not.
TEST(LidarSampler, ReturnsMoveWithTheirFrames) {
  const LidarReturns r = returns(60);
  Scene scene;
  scene.global_from_world = Rigid3d(Eigen::AngleAxisd(0.9, Eigen::Vector3d(1, -2, 3).normalized()));
  scene.global_from_world.translation() = Eigen::Vector3d(4e6, 1e6, 5e6);
  scene.add_frame({0, 0, Rigid3d::Identity()});
  scene.add_frame({1, 59, Rigid3d(Eigen::Translation3d(10, 0, 0))});
  const LidarSampler sampler(r, scene, 5);
  RayBatch before, batch;
  sampler.gather(0, 60, &before);
  PoseCorrections corrections(scene);
  scene.correct(corrections);
  sampler.gather(0, 60, &batch);
  for (std::size_t i = 0; i < 180; ++i) {
    EXPECT_NEAR(batch.origin[i], before.origin[i], 2e-4);
    EXPECT_NEAR(batch.direction[i], before.direction[i], 1e-6);
  }
  corrections.values[corrections.frame_slot(1) + 1] = 0.2f;
  corrections.values[corrections.frame_slot(1) + 5] = 0.01f;
  scene.correct(corrections);
  sampler.gather(0, 60, &batch);
  EXPECT_EQ(batch.range_m, before.range_m);
  for (std::size_t i = 0; i < 60; ++i) {
    const double t = batch.range_m[i] - 1, part = t / 59;
    const Eigen::Vector3d at(10 * part, 0, 0), up = Eigen::Vector3d::UnitZ();
    const Eigen::AngleAxisd turn(0.01 * part, up);
    const auto vector = [&](const std::vector<float>& of) {
      return Eigen::Vector3d(of[i], of[60 + i], of[120 + i]);
    };
    const Eigen::Vector3d origin =
        turn * (vector(before.origin) - at) + at + Eigen::Vector3d(0, 0.2 * part, 0);
    EXPECT_LT((vector(batch.origin) - origin).norm(), 1e-3) << t;
    EXPECT_LT((vector(batch.direction) - turn * vector(before.direction)).norm(), 1e-6) << t;
  }
}

}  // namespace
}  // namespace redrive
