// SPDX-License-Identifier: Apache-2.0
// Detects starts that fail. A start has failed when it is
//   not finite:  a step within the first 1000 gives no finite loss or gradients;
//   dead:        mean opacity below 1e-4 in 20 consecutive steps within the first 1000: every
//                density is at or below the kink of its ReLU, and all gradients are zero;
//   diverging:   the mean squared error over steps 400..499 is not 10 % below the error of steps
//   0..19.
// A field that explains its images has not failed: none is dead or diverging below an error of 1e-4
// (40 dB: black images, one constant colour), nor diverging while it is no worse than the best
// constant colour (noise).
#pragma once

#include <optional>
#include <string>

#include "redrive/train/files/state.h"
#include "redrive/train/step.h"

namespace redrive {

constexpr std::int64_t kStartSteps = 1000;  ///< steps of a start that are checked
constexpr int kMaxRestarts = 5;
constexpr double kExplainedMse = 1e-4;  ///< 40 dB: the field explains its images

/// Whether step number `step` needs StepOutput::colour_variance.
bool watches_colours(std::int64_t step);

/// Checks step number `step` (from 0) of this start. Returns the reason to restart from another
/// seed, or nothing.
std::optional<std::string> watch_start(const StepResult& result, std::int64_t step,
                                       StartWatch* watch);

}  // namespace redrive
