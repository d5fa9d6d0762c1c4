// SPDX-License-Identifier: Apache-2.0
// Closes a trajectory over places that it visits twice: a pose graph (Grisetti et al., "A Tutorial
// on Graph-Based SLAM", 2010) of knots along the way, links between neighbours, and measured
// motions between knots that lie far apart along the way. Closures that contradict the others, or
// that the trajectory's largest drift does not explain, are rejected.
#pragma once

#include <vector>

#include "redrive/align/rigid_motions.h"
#include "redrive/math/rigid3.h"

namespace redrive {

/// Largest drift of a trajectory, as a random walk: standard deviations after 1 m, which grow with
/// the root of the way. After 300 m the end is known to 1.1 m, mainly limited by its direction.
constexpr double kDrift_m = 0.02, kDrift_rad = 3.5e-4;

/// Standard deviation of the position at the end of so much way relative to its start.
double drift_m(double way_m);

/// A pose of the trajectory. Neighbours are joined by a link with their relative motion.
struct Knot {
  Rigid3d world_from_body = Rigid3d::Identity();
  double way_m = 0;                      ///< way driven up to here
  Vector6d variance = Vector6d::Zero();  ///< stated: translation (m^2), rotation, body axes
};

/// A measurement: the pose of knot `to` in the axes of knot `from`.
struct LoopClosure {
  int from = 0, to = 0;
  Rigid3d from_to = Rigid3d::Identity();
  /// covariance of `to`: translation, rotation, in its axes
  Matrix6d covariance = Matrix6d::Identity();
};

struct ClosedTrajectory {
  std::vector<Rigid3d> poses;  ///< poses of the knots; bit for bit the same if nothing was accepted
  /// variances of the changes, as Knot::variance, a rigid motion of the whole excluded; zero if
  /// nothing was accepted
  std::vector<Vector6d> variance;
  std::vector<bool> accepted;  ///< one per closure
  /// RMS difference between the accepted closures and the trajectory, before and after.
  double before_m = 0, before_rad = 0, after_m = 0, after_rad = 0;
};

/// `knots`: in order, at least two where there is a closure. A link's variance is the variance of
/// the largest drift plus the stated variances of its ends, times the sum of all squared residuals
/// for each of the 6 numbers of the closures (the a posteriori variance factor). What is in no loop
/// keeps its place but for a weak prior.
ClosedTrajectory close_trajectory(const std::vector<Knot>& knots,
                                  const std::vector<LoopClosure>& closures);

}  // namespace redrive
