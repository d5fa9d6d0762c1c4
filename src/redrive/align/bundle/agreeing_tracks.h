// SPDX-License-Identifier: Apache-2.0
// Finds the observations that agree with the present corrections of a rig.
#pragma once

#include <vector>

#include "redrive/align/bundle/adjustment_problem.h"
#include "redrive/align/bundle/doubtful_frames.h"

namespace redrive {

inline constexpr double kStartSigma_px = 4;  ///< in the first round; later the residuals' median
/// residuals above this many standard deviations are outliers
inline constexpr double kOutlierSigmas = 4;

/// Returns the median of the values, which it reorders; 0 if there are none.
double median_or_zero(std::vector<double>* values);

/// The tracks that agree with the present corrections, and their noise by camera.
struct AgreeingTracks {
  std::vector<TriangulatedTrack> triangulated;
  std::vector<double> sigma_px;
  std::vector<FrameSupport> support;
};

/// Finds them. A frame that most of its observations contradict restarts between its neighbours
/// first, twice at most. `sigma_px`: the noise so far; `restarts`: for each frame, how often it
/// did.
AgreeingTracks find_agreeing(const std::vector<Track>& tracks, std::vector<double> sigma_px,
                             ThreadPool& pool, RigModel* model, std::vector<int>* restarts);

}  // namespace redrive
