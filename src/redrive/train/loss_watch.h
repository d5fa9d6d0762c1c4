// SPDX-License-Identifier: Apache-2.0
// Looks on after the start (train/start_watch.h looks at its first 1000 steps): a loss that rises and stays high is a divergence.
//
// Windows of metrics.jsonl are smoothed, mean squared errors weighted by their rays over the last 10^5. The loss is high while that is
// more than twice the best it has been, and above 1e-4 (40 dB), where a field explains its pictures; it has diverged when ten
// windows on end (250 steps) are. Twice is far from noise: of a batch's squared errors the standard deviation is two or three times
// their mean, so over 10^5 rays the mean is known to 1 %, and healthy runs of either method stay within 2 % of their best.
#pragma once

#include "redrive/train/state.h"

namespace redrive {

constexpr double kHighLoss = 2;        ///< times the best smoothed one
constexpr int kHighWindows = 10;       ///< on end: diverged
constexpr double kRollbackRate = 0.5;  ///< what a roll-back multiplies the learning rate by
constexpr int kMaxRollbacks = 4;

/// Takes in a window that ends at `step` (steps done).
void watch_loss(const LossWindow& window, std::int64_t step, LossWatch* watch);

inline bool has_diverged(const LossWatch& watch) { return watch.high >= kHighWindows; }
/// The mean of a window, whole or not, of at least 1000 rays is itself high, or the last ones' was: maybe noise, maybe the beginning of
/// the end, and no state to go back to.
bool is_high(const LossWindow& window, std::int64_t step, const LossWatch& watch);

}  // namespace redrive
