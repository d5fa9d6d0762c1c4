// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/start_watch.h"

#include <algorithm>
#include <cstdio>

namespace redrive {
namespace {

constexpr double kDeadOpacity = 1e-4;
constexpr int kDeadSteps = 20;
constexpr std::int64_t kFirstSteps = 20, kLateBegin = 400, kLateEnd = 500;
/// The variance over 100 batches of 1024 rays estimates the variance of all pixels to about 1 %,
/// and the error of a constant colour scatters as much. 1.1 allows ten times that.
constexpr double kVarianceMargin = 1.1;
/// The first 20 steps may include diverged ones; a field that learns is far below their mean after
/// 400.
constexpr double kProgress = 0.9;

std::string format(const char* text, double a, double b) {
  char buffer[200];
  std::snprintf(buffer, sizeof buffer, text, a, b);
  return buffer;
}

}  // namespace

bool watches_colours(std::int64_t step) { return step >= kLateBegin && step < kLateEnd; }

std::optional<std::string> watch_start(const StepResult& result, std::int64_t step,
                                       StartWatch* watch) {
  if (step >= kStartSteps) return std::nullopt;
  if (!result.finite) return "diverging: loss or gradients are not finite";

  const bool dead = result.opacity < kDeadOpacity && result.rgb_mse > kExplainedMse;
  watch->dead_steps = dead ? watch->dead_steps + 1 : 0;
  if (watch->dead_steps >= kDeadSteps)
    return format("dead: mean opacity %.1e for %.0f steps on end, no gradient is left",
                  result.opacity, watch->dead_steps);

  if (step < kFirstSteps) watch->first_mse += result.rgb_mse;
  if (watches_colours(step)) {
    watch->late_mse += result.rgb_mse;
    watch->late_variance += result.colour_variance;
  }
  if (step == kLateEnd - 1) {
    const double first = watch->first_mse / kFirstSteps,
                 late = watch->late_mse / (kLateEnd - kLateBegin);
    const double constant_colour = watch->late_variance / (kLateEnd - kLateBegin);
    if (late >= kProgress * first && late > kExplainedMse &&
        late > kVarianceMargin * constant_colour)
      return format(
          "diverging: mean squared error %.3g over steps 400 to 499, hardly below the %.3g it "
          "began with",
          late, first);
  }
  return std::nullopt;
}

}  // namespace redrive
