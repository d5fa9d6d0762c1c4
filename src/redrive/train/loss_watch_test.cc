// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/loss_watch.h"

#include <cmath>

#include <gtest/gtest.h>

#include "redrive/base/rng.h"
#include "redrive/train/start_watch.h"

namespace redrive {
namespace {

constexpr int kSteps = 25;

/// Windows of one loss, `rays` a step, from step `*step` on; the first after which it is said to have diverged, -1 if none.
int windows_until_diverged(double mse, int windows, int rays, std::int64_t* step, LossWatch* watch) {
  for (int i = 0; i < windows; ++i) {
    *step += kSteps;
    LossWindow window;
    window.steps = kSteps;
    window.rays = std::int64_t{kSteps} * rays;
    window.mse = kSteps * mse;
    watch_loss(window, *step, watch);
    if (has_diverged(*watch)) return i;
  }
  return -1;
}

TEST(LossWatch, SaysSoAfterTenHighWindows) {
  LossWatch watch;
  std::int64_t step = kStartSteps;
  EXPECT_EQ(windows_until_diverged(0.01, 50, 4096, &step, &watch), -1);  // a window is 10^5 rays: no memory
  EXPECT_FALSE(is_high({}, step, watch));
  EXPECT_EQ(windows_until_diverged(0.021, 50, 4096, &step, &watch), kHighWindows - 1);
}

TEST(LossWatch, LessThanTwiceIsNothing) {
  LossWatch watch;
  std::int64_t step = kStartSteps;
  windows_until_diverged(0.01, 50, 4096, &step, &watch);
  EXPECT_EQ(windows_until_diverged(0.0199, 500, 4096, &step, &watch), -1);
  EXPECT_FALSE(is_high({}, step, watch));
}

TEST(LossWatch, APeakThatPassesIsNothing) {
  LossWatch watch;
  std::int64_t step = kStartSteps;
  for (int peak = 0; peak < 5; ++peak) {
    windows_until_diverged(0.01, 10, 4096, &step, &watch);
    EXPECT_FALSE(is_high({}, step, watch));
    EXPECT_EQ(windows_until_diverged(1, kHighWindows - 1, 4096, &step, &watch), -1);
    EXPECT_TRUE(is_high({}, step, watch));
  }
}

// Before the smoothed loss follows, so that no checkpoint is of a state that has just gone astray.
TEST(LossWatch, AWindowMayBeHighBeforeTheOthers) {
  LossWatch watch;
  std::int64_t step = kStartSteps;
  windows_until_diverged(0.01, 100, 128, &step, &watch);
  const auto high = [&](int steps, int rays, double mse) {
    LossWindow window;
    window.steps = steps;
    window.rays = std::int64_t{steps} * rays;
    window.mse = steps * mse;
    return is_high(window, step, watch);
  };
  EXPECT_TRUE(high(8, 128, 0.021));
  EXPECT_FALSE(high(8, 128, 0.019));
  EXPECT_FALSE(high(7, 128, 1)) << "too few rays to say so";
}

// The start has a watch of its own; what it was at its best counts all the same.
TEST(LossWatch, LeavesTheStartAlone) {
  LossWatch watch;
  std::int64_t step = 0;
  windows_until_diverged(0.01, 10, 4096, &step, &watch);
  EXPECT_EQ(windows_until_diverged(1, 30, 4096, &step, &watch), -1);
  EXPECT_EQ(step, kStartSteps);
  EXPECT_FALSE(is_high({}, step, watch));
  EXPECT_EQ(windows_until_diverged(1, 30, 4096, &step, &watch), kHighWindows - 1);
}

TEST(LossWatch, AFieldThatExplainsItsPicturesMayWaver) {
  LossWatch watch;
  std::int64_t step = kStartSteps;
  windows_until_diverged(1e-6, 10, 4096, &step, &watch);
  EXPECT_EQ(windows_until_diverged(9e-5, 100, 4096, &step, &watch), -1);
}

// Squared errors of single rays whose standard deviation is three times their mean, as of few edges before an even wall: one in ten
// is 10, the others nothing. The smaller a batch, the more windows are smoothed.
TEST(LossWatch, NoiseOfSmallBatchesIsNone) {
  for (const int rays : {1, 16, 1024}) {
    LossWatch watch;
    std::int64_t step = 0;
    std::uint64_t ray = 0;
    for (int i = 0; i < 20000 / (rays > 16 ? 20 : 1); ++i) {
      int hits = 0;
      for (int k = 0; k < kSteps * rays; ++k) hits += random_unit(7, ray++) < 0.1f;
      const double mse = 0.1 * hits / (kSteps * rays);
      ASSERT_EQ(windows_until_diverged(mse, 1, rays, &step, &watch), -1) << rays << " rays, step " << step;
      ASSERT_FALSE(is_high({}, step, watch)) << rays << " rays, step " << step;
    }
    EXPECT_GT(watch.best, 0) << rays;
    EXPECT_NE(windows_until_diverged(0.1, 100000, rays, &step, &watch), -1) << rays;
  }
}

}  // namespace
}  // namespace redrive
