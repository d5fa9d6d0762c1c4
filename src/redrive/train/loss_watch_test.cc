// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/loss_watch.h"

#include <cmath>

#include <gtest/gtest.h>

#include "redrive/base/rng.h"

namespace redrive {
namespace {

constexpr int kSteps = 25;

/// Feeds windows of one loss with `rays` per step; returns the first one after which the watch
/// reports divergence, -1 if none.
int windows_until_diverged(double mse, int windows, int rays, LossWatch* watch) {
  for (int i = 0; i < windows; ++i) {
    LossWindow window;
    window.steps = kSteps;
    window.rays = std::int64_t{kSteps} * rays;
    window.mse = kSteps * mse;
    watch_loss(window, watch);
    if (has_diverged(*watch)) return i;
  }
  return -1;
}

TEST(LossWatch, ReportsDivergenceAfterTenHighWindows) {
  LossWatch watch;
  EXPECT_EQ(windows_until_diverged(0.01, 50, 4096, &watch),
            -1);  // a window is 10^5 rays, so nothing is smoothed
  EXPECT_FALSE(is_high({}, watch));
  EXPECT_EQ(windows_until_diverged(0.021, 50, 4096, &watch), kHighWindows - 1);
}

TEST(LossWatch, IgnoresLessThanTwiceTheBestLoss) {
  LossWatch watch;
  windows_until_diverged(0.01, 50, 4096, &watch);
  EXPECT_EQ(windows_until_diverged(0.0199, 500, 4096, &watch), -1);
  EXPECT_FALSE(is_high({}, watch));
}

TEST(LossWatch, IgnoresAShortPeak) {
  LossWatch watch;
  for (int peak = 0; peak < 5; ++peak) {
    windows_until_diverged(0.01, 10, 4096, &watch);
    EXPECT_FALSE(is_high({}, watch));
    EXPECT_EQ(windows_until_diverged(1, kHighWindows - 1, 4096, &watch), -1);
    EXPECT_TRUE(is_high({}, watch));
  }
}

// A single window can be high before the smoothed loss is, so that no checkpoint has a state that
// just diverged.
TEST(LossWatch, AWindowMayBeHighBeforeTheOthers) {
  LossWatch watch;
  windows_until_diverged(0.01, 100, 128, &watch);
  const auto high = [&](int steps, int rays, double mse) {
    LossWindow window;
    window.steps = steps;
    window.rays = std::int64_t{steps} * rays;
    window.mse = steps * mse;
    return is_high(window, watch);
  };
  EXPECT_TRUE(high(8, 128, 0.021));
  EXPECT_FALSE(high(8, 128, 0.019));
  EXPECT_FALSE(high(7, 128, 1)) << "too few rays to judge";
}

// A grid with ten times its learning rate and 256 rays learns for 150 steps, then loses most of it.
// Two windows are 10^4 rays.
TEST(LossWatch, DetectsALossAfterAFewHundredSteps) {
  LossWatch watch;
  for (const double mse :
       {0.047, 0.020, 0.015, 0.0148, 0.0137, 0.0127, 0.0128, 0.0141, 0.0141, 0.0161, 0.0242})
    EXPECT_EQ(windows_until_diverged(mse, 1, 256, &watch), -1);
  EXPECT_NEAR(watch.best, 0.013, 0.0005);
  EXPECT_FALSE(is_high({}, watch));
  EXPECT_EQ(windows_until_diverged(0.0302, 1, 256, &watch), -1);
  EXPECT_TRUE(is_high({}, watch));
  EXPECT_EQ(windows_until_diverged(0.036, 50, 256, &watch), kHighWindows - 2);
}

TEST(LossWatch, IgnoresFluctuationsOfAConvergedField) {
  LossWatch watch;
  windows_until_diverged(1e-6, 10, 4096, &watch);
  EXPECT_EQ(windows_until_diverged(9e-5, 100, 4096, &watch), -1);
}

// Squared errors of single rays have a standard deviation of three times their mean, as with a few
// edges before a plain wall: one in ten is 10, the others 0. Smaller batches are smoothed over more
// windows.
TEST(LossWatch, IgnoresTheNoiseOfSmallBatches) {
  for (const int rays : {1, 16, 1024}) {
    LossWatch watch;
    std::uint64_t ray = 0;
    for (int i = 0; i < 20000 / (rays > 16 ? 20 : 1); ++i) {
      int hits = 0;
      for (int k = 0; k < kSteps * rays; ++k) hits += random_unit(7, ray++) < 0.1f;
      const double mse = 0.1 * hits / (kSteps * rays);
      ASSERT_EQ(windows_until_diverged(mse, 1, rays, &watch), -1) << rays << " rays, window " << i;
      ASSERT_FALSE(is_high({}, watch)) << rays << " rays, window " << i;
    }
    EXPECT_GT(watch.best, 0) << rays;
    EXPECT_NE(windows_until_diverged(0.1, 100000, rays, &watch), -1) << rays;
  }
}

}  // namespace
}  // namespace redrive
