// SPDX-License-Identifier: Apache-2.0
// Detects divergence: a loss that rises and stays high, at any step. (train/start_watch.h detects
// starts that fail.)
//
// Windows of metrics.jsonl are smoothed, mean squared errors weighted by their rays over the last
// 10^4. The loss is high while that is more than twice the best it has been, and above 1e-4 (40
// dB), where a field explains its pictures; it has diverged when ten windows on end (250 steps)
// are. Twice is far from noise: of a batch's squared errors the standard deviation is two or three
// times their mean, so over 10^4 rays the mean is known to 3 %, and healthy runs of either method
// stay within 20 % of their best. Ten times as many rays would be known better, but small batches
// would need 400 steps for them: a rate far too high lets a grid learn for 150 steps and then lose
// it, which must not be averaged away.
#pragma once

#include "redrive/train/state.h"

namespace redrive {

constexpr double kHighLoss = 2;        ///< times the best smoothed one
constexpr int kHighWindows = 10;       ///< consecutive ones: diverged
constexpr double kRollbackRate = 0.5;  ///< factor of the learning rate at a roll-back
constexpr int kMaxRollbacks = 4;

/// Updates the check with a window.
void watch_loss(const LossWindow& window, LossWatch* watch);

inline bool has_diverged(const LossWatch& watch) { return watch.high >= kHighWindows; }
/// Whether the mean of a window of at least 1000 rays, or that of the windows before, is high. It
/// may be noise or the onset of divergence: no checkpoint is written then.
bool is_high(const LossWindow& window, const LossWatch& watch);

}  // namespace redrive
