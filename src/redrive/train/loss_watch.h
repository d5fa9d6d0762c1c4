// SPDX-License-Identifier: Apache-2.0
// Detects divergence: a loss that rises and stays high, at any step. (train/start_watch.h detects
// starts that fail.)
//
// The mean squared errors of windows of metrics.jsonl are averaged over the last 10^4 rays. The
// loss is high while that average is more than twice its minimum so far and above 1e-4 (40 dB),
// where a field explains its images. It has diverged after ten consecutive high windows (250
// steps). Twice is far above noise: the standard deviation of squared errors is two or three times
// their mean, so the mean over 10^4 rays has an error of 3 %, and healthy runs of either method
// stay within 20 % of their minimum. The minimum begins anew when errors stop being comparable: at
// another stage of the schedule (StepOutput::stage), when pose refinement begins, with other masks
// and with another number of processes. A loss that is high just then is rolled back, so that it
// does not become the reference. Ten times as many rays would take 400 steps of small batches and
// average away a divergence: with a much too high learning rate, a grid learns for 150 steps only.
#pragma once

#include "redrive/train/files/state.h"

namespace redrive {

constexpr double kHighLoss = 2;        ///< times the best smoothed one
constexpr int kHighWindows = 10;       ///< consecutive ones: diverged
constexpr double kRollbackRate = 0.5;  ///< factor of the learning rate at a roll-back
constexpr int kMaxRollbacks = 4;

/// Updates the check with a window.
void watch_loss(const LossWindow& window, LossWatch* watch);

inline bool has_diverged(const LossWatch& watch) { return watch.high >= kHighWindows; }
/// Whether the mean of a window of at least 1000 rays, or of the windows before, is high. It may be
/// noise or the onset of divergence: no checkpoint is written then.
bool is_high(const LossWindow& window, const LossWatch& watch);

}  // namespace redrive
