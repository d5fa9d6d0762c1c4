// SPDX-License-Identifier: Apache-2.0
// Which observations agree with the present corrections of a rig.
#pragma once

#include <vector>

#include "redrive/align/bundle/adjustment_problem.h"
#include "redrive/align/bundle/doubtful_frames.h"

namespace redrive {

inline constexpr double kStartSigma_px = 4;  ///< in the first round; later the residuals' median
inline constexpr double kOutlierSigmas = 4;  ///< standard deviations of an outlier

/// Median of the values, which it reorders; 0 of none.
double median_or_zero(std::vector<double>* values);

/// The tracks that agree with the present corrections, and their noise by camera.
struct AgreeingTracks {
  std::vector<TriangulatedTrack> triangulated;
  std::vector<double> sigma_px;
  std::vector<FrameSupport> support;
};

/// Finds them. A frame that most of its observations contradict begins again between its neighbours
/// first, twice at most. `sigma_px`: the noise so far; `restarts`: by frame, how often it did.
AgreeingTracks find_agreeing(const std::vector<Track>& tracks, std::vector<double> sigma_px,
                             ThreadPool& pool, RigModel* model, std::vector<int>* restarts);

}  // namespace redrive
