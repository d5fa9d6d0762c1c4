// SPDX-License-Identifier: Apache-2.0
// Loop closures: where the drive passes a place again, LiDAR points of both passes are registered
// with each other (lidar/register_maps.h), and the difference from the trajectory is spread along
// the way between (pose_graph.h).
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "redrive/align/align.h"
#include "redrive/align/join_trajectories.h"
#include "redrive/align/lidar/register_maps.h"

namespace redrive {

/// Two passes of a place: frames, by index.
struct LoopCandidate {
  int from = 0, to = 0;
  double way_m = 0;       ///< driven between them
  double distance_m = 0;  ///< between their positions
};

/// Places that the drive passes again after 60 m of way or more, a pair each 20 m: `to` is every
/// such frame, `from` the nearest earlier one. Their distance is at most two lanes plus the drift
/// over the way between, and at most max_search_m. Takes time linear in the drive's length.
std::vector<LoopCandidate> find_loop_candidates(const std::vector<FramePose>& frames);

/// Bound of the horizontal search for the drift: three deviations (drift_m), 12 m at most.
double loop_search_m(double way_m);

/// LiDAR points of some frames, in global axes of `frames`, the aligned trajectory.
using PointsOfFrames = std::function<std::vector<Eigen::Vector3d>(const FrameWindow& frames)>;

/// The results of close_loops.
struct LoopClosures {
  int candidates = 0, registered = 0, accepted = 0;
  /// RMS difference of the accepted closures from the trajectory
  double before_m = 0, before_rad = 0;
  double after_m = 0, after_rad = 0;
  std::vector<std::string> doubts;  ///< one per candidate that was not registered: why
};

/// Closes the loops of an aligned drive. Changes frames, corrections and their deviations, unless
/// nothing is accepted.
LoopClosures close_loops(const Recording& recording, const PointsOfFrames& points,
                         AlignResult* result);
/// The same with the recording's LiDAR. Adds a remark where there are candidates.
void close_loops(const Recording& recording, const AlignOptions& options, ThreadPool& pool,
                 AlignResult* result);

}  // namespace redrive
