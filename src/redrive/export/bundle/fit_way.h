// SPDX-License-Identifier: Apache-2.0
// A driven way as lines, arcs and clothoids, the geometries of OpenDRIVE's planView.
#pragma once

#include <cmath>
#include <span>
#include <vector>

#include <Eigen/Core>

namespace redrive {

/// Position and heading (from x to y, radians) in the plane, metres.
struct PlanPose {
  double x = 0, y = 0, heading_rad = 0;
  Eigen::Vector2d position() const { return {x, y}; }
  Eigen::Vector2d ahead() const { return {std::cos(heading_rad), std::sin(heading_rad)}; }
};

/// A piece whose curvature is linear in its length: a line (both 0), an arc (rate 0), a clothoid.
struct PlanPiece {
  PlanPose start;
  double length_m = 0;
  double curvature_per_m = 0;        ///< at the start, to the left
  double curvature_rate_per_m2 = 0;  ///< its change by length

  double end_curvature_per_m() const { return curvature_per_m + curvature_rate_per_m2 * length_m; }
  /// Returns the pose after a length; beyond the ends the piece goes on.
  PlanPose at(double length_m) const;
};

/// Returns the clothoid from a pose to another one (Bertolazzi and Frego, "G1 fitting with
/// clothoids", 2015); length 0 where there is none that turns by less than half a turn.
PlanPiece clothoid_between(const PlanPose& from, const PlanPose& to);

/// Returns the distance of a point from a piece, and its place along it, metres.
struct Foot {
  double distance_m = 0, along_m = 0;
};
Foot foot_on(const PlanPiece& piece, const Eigen::Vector2d& point);

/// Most that lines and arcs, and clothoids, leave the points of fit_way.
constexpr double kLineTolerance_m = 0.02, kClothoidTolerance_m = 0.04;

/// Fits pieces to points in driving order, which may be noisy. Each piece begins at the pose at
/// which the one before ends. The longest pieces within the tolerances are taken, up to 200 m,
/// lines before arcs before clothoids where they reach about as far; where even a clothoid between
/// two points 0.4 m apart leaves them by more, it stays. Empty for points that are not 0.4 m apart.
std::vector<PlanPiece> fit_way(std::span<const Eigen::Vector2d> points);

}  // namespace redrive
