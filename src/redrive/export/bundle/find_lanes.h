// SPDX-License-Identifier: Apache-2.0
// Lanes beside a driven way, by the intensities and heights of LiDAR returns.
#pragma once

#include <optional>
#include <span>

namespace redrive {

/// Width of a lane whose edges are not seen.
constexpr double kAssumedLane_m = 3.5;
/// How far from the way find_lanes looks.
constexpr double kLanesReach_m = 8;

/// A return of the ground beside a way.
struct WayReturn {
  double along_m = 0, across_m = 0;  ///< across: to the left of the way
  double height_m = 0;               ///< above the plane through the way
  double intensity = 0;
};

struct LaneEdge {
  enum class Kind { kAssumed, kMarking, kKerb };
  double across_m = 0;
  Kind kind = Kind::kAssumed;
};

struct Lanes {
  LaneEdge left, right;  ///< edges of the driven lane; right.across_m < 0
  /// Outer edges of the lanes beside it, where the ground there is road.
  std::optional<LaneEdge> left_neighbour, right_neighbour;

  bool is_measured() const {
    return left.kind != LaneEdge::Kind::kAssumed && right.kind != LaneEdge::Kind::kAssumed;
  }
};

/// Parts of the way are 4 m long, strips 0.1 m wide. A marking is a strip of at most 0.4 m that is
/// half as bright again as the ground on both sides of it, in a quarter or more of the parts that
/// have returns there: dashes are a third of a line. A kerb is a step of 5 cm upwards or downwards
/// within 0.4 m, in half of the parts.
///
/// The driven lane lies between the nearest marking or kerb, 0.8 to 3.2 m on either side, where
/// these are 2.4 to 5 m apart; else the way is the middle of a lane of the assumed width. There is
/// a lane beside it where the ground goes on without a kerb for 2.4 m or more, as even as the
/// driven lane and as bright within a factor of 1.6. It ends at a marking or kerb 2.4 to 4.5 m
/// further on, or has the driven lane's width, if the road is that wide.
Lanes find_lanes(std::span<const WayReturn> returns);

}  // namespace redrive
