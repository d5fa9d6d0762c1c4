// SPDX-License-Identifier: Apache-2.0
// Markings beside a driven way, by the intensities of LiDAR returns.
#pragma once

#include <optional>
#include <span>

namespace redrive {

/// A return of the ground beside a way.
struct WayReturn {
  double along_m = 0, across_m = 0;  ///< across: to the left of the way
  double intensity = 0;
};

/// Places of the markings on both sides of the way.
struct LaneEdges {
  double left_m = 0, right_m = 0;  ///< across; right_m < 0
};

/// Returns the nearest markings, 0.8 to 3.2 m on either side, that are 2.4 to 5 m apart; nothing
/// where one side shows none. A marking is a strip of at most 0.4 m that is half as bright again as
/// the ground on both sides of it, in a quarter or more of the way's parts of 4 m that have returns
/// there: dashes are a third of a line.
std::optional<LaneEdges> find_lane_edges(std::span<const WayReturn> returns);

}  // namespace redrive
