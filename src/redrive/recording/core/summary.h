// SPDX-License-Identifier: Apache-2.0
// Length, speed and frame rate of a trajectory.
#pragma once

#include <vector>

#include "redrive/recording/core/recording.h"

namespace redrive {

struct DriveSummary {
  double duration_s = 0;          ///< last minus first time
  double rate_hz = 0;             ///< 1 / median interval; 0 with fewer than two frames
  double path_length_m = 0;       ///< sum of the distances between consecutive poses
  double mean_speed_m_per_s = 0;  ///< path_length_m / duration_s
  double max_speed_m_per_s = 0;   ///< largest distance / interval of two consecutive poses
  std::vector<Finding> findings;  ///< gaps in time, and poses that contradict their neighbours
};

/// `frames`: sorted by id, with increasing times, as in Recording. All zero for fewer than two.
DriveSummary summarize_drive(const std::vector<FramePose>& frames);

}  // namespace redrive
