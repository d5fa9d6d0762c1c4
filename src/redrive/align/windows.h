// SPDX-License-Identifier: Apache-2.0
// Aligns a long drive in overlapping windows, in time and memory linear in its length: only one
// window's images are in memory at a time. Each window is aligned on its own; the windows'
// estimates of the cameras are combined; each window is aligned again with cameras fixed, from the
// same tracks; and the trajectories are joined (join_trajectories.h).
#pragma once

#include <functional>
#include <optional>
#include <vector>

#include "redrive/align/align.h"
#include "redrive/align/join_trajectories.h"

namespace redrive {

/// A window's estimate of one number, as a change of its initial value.
struct NumberEstimate {
  double change = 0, sigma = 0;
};

/// Combines estimates of windows by their information. Each contains the prior, of standard
/// deviation `prior` and, if `robust`, a Cauchy distribution (BundlePriors), which counts once. The
/// variance is multiplied by `repeated` >= 1, how often a frame is counted on average, and by chi^2
/// per degree of freedom where that is above 1, which measures how much the windows disagree
/// (Birge, "The calculation of errors by the method of least squares", 1932). Nothing without
/// estimates.
std::optional<NumberEstimate> combine_estimates(const std::vector<NumberEstimate>& windows,
                                                double prior, bool robust, double repeated);

/// Aligns one window: `part` has its frames. Called once for each window, in order, with the
/// options given, and then once more with BundleOptions::fixed_cameras and the drive's calibration.
using AlignPart = std::function<AlignResult(const FrameWindow& window, const Recording& part,
                                            const AlignOptions& options)>;

/// Throws as align; the message names the frames of the window that cannot be aligned. In the
/// result, `bundle` sums up the second alignments, without covariances and contrast, so errors with
/// initial poses use the drive's cameras; edge scores come from the first alignments.
AlignResult align_in_windows(const Recording& recording, const AlignOptions& options,
                             const AlignPart& align_part);
AlignResult align_in_windows(const Recording& recording, const AlignOptions& options,
                             ThreadPool& pool);

}  // namespace redrive
