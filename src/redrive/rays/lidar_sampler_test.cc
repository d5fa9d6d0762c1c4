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
    for (std::size_t i = 0; i < n; ++i) {
      r.origin.push_back(static_cast<float>(1000 * k + i));
      r.direction.push_back(static_cast<float>(k == i % 3));
    }
  for (std::size_t i = 0; i < n; ++i) r.range_m.push_back(static_cast<float>(1 + i));
  return r;
}

TEST(LidarSampler, DrawsEachReturnOnceBeforeAnyTwice) {
  const LidarReturns r = returns(60);
  const LidarSampler sampler(r, 5);
  RayBatch batch;
  std::map<float, int> drawn;
  bool in_order = true;
  for (int step = 0; step < 8; ++step) {  // 8 x 15: all of them twice
    sampler.gather(step, 15, &batch);
    ASSERT_EQ(batch.n, 15);
    for (int i = 0; i < 15; ++i) {
      const float range = batch.range_m[i];
      ++drawn[range];
      in_order = in_order && range == 1 + static_cast<float>((15 * step + i) % 60);
      const int k = static_cast<int>(range) - 1;
      for (int d = 0; d < 3; ++d) {
        EXPECT_EQ(batch.origin[d * 15 + i], 1000 * d + k);
        EXPECT_EQ(batch.direction[d * 15 + i], d == k % 3);
      }
      EXPECT_GT(batch.pixel_angle[i], 0);
    }
    if (step % 4 == 3) EXPECT_EQ(drawn.size(), 60u);
    for (const auto& [range, times] : drawn) EXPECT_LE(times, step < 4 ? 1 : 2);
  }
  EXPECT_FALSE(in_order) << "not shuffled";
}

TEST(LidarSampler, IsAFunctionOfSeedAndStep) {
  const LidarReturns r = returns(1000);
  RayBatch a, b, c;
  LidarSampler(r, 5).gather(3, 64, &a);
  LidarSampler(r, 5).gather(3, 64, &b);
  LidarSampler(r, 6).gather(3, 64, &c);
  EXPECT_EQ(a.range_m, b.range_m);
  EXPECT_NE(a.range_m, c.range_m);
}

}  // namespace
}  // namespace redrive
