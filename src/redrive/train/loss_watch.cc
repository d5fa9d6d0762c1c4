// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/loss_watch.h"

#include <algorithm>

#include "redrive/train/start_watch.h"

namespace redrive {
namespace {

constexpr double kSmoothingRays = 1e4;
constexpr std::int64_t kRaysOfWindow = 1000;  // its mean has a standard error of 10 %

bool is_high(double mse, const LossWatch& watch) {
  return watch.best > 0 && mse > std::max(kHighLoss * watch.best, kExplainedMse);
}

}  // namespace

bool is_high(const LossWindow& window, const LossWatch& watch) {
  return watch.high > 0 ||
         (window.rays >= kRaysOfWindow && is_high(window.mse / window.steps, watch));
}

void watch_loss(const LossWindow& window, LossWatch* watch) {
  if (window.steps == 0 || window.rays == 0) return;  // a few masked pixels are no evidence
  const auto rays = static_cast<double>(window.rays);
  watch->rays = std::min(watch->rays + rays, kSmoothingRays);
  // Plain mean until there are enough rays, an exponential moving average from then on.
  watch->smoothed +=
      rays / std::max(watch->rays, rays) * (window.mse / window.steps - watch->smoothed);
  if (watch->rays < kSmoothingRays) return;
  if (watch->best == 0 || watch->smoothed < watch->best) watch->best = watch->smoothed;
  watch->high = is_high(watch->smoothed, *watch) ? watch->high + 1 : 0;
}

}  // namespace redrive
