// SPDX-License-Identifier: Apache-2.0
// Registers the LiDAR points of two passes of a place: upright surfaces seen from above are
// correlated over all shifts within a bound (Olson, "Real-Time Correlative Scan Matching", 2009),
// and points are then moved onto the planes of the other pass (point to plane; Chen and Medioni
// 1992).
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "redrive/math/rigid3.h"

namespace redrive {

/// Points in metres, in the axes of the body at the middle of a stretch of the way.
using PointMap = std::vector<Eigen::Vector3d>;

constexpr double kMapReach_m = 40;  ///< horizontal distance up to which points count

struct MapRegistration {
  Rigid3d target_from_source = Rigid3d::Identity();
  /// Covariance of the source's pose, in its axes: translation (m), rotation (rad). Large along
  /// what the surfaces do not constrain. At least (2 cm)^2 and (0.03 degrees)^2.
  Eigen::Matrix<double, 6, 6> covariance = Eigen::Matrix<double, 6, 6>::Zero();
  double overlap = 0;  ///< share of the source's points with a target point nearby
  /// Share of the source's points above the ground, within 25 m of both places, that lie on
  /// surfaces of the target: within 0.15 m of a plane, or among points that lie on no plane, such
  /// as leaves.
  double upright = 0;
  double residual_m = 0;  ///< RMS distance of all points within 0.15 m of a plane from it
  /// Why it cannot be trusted: too little overlap, or surfaces that do not fit. Empty: it can be.
  std::string doubt;
};

/// `guess`: target from source, to within `search_m` horizontally (the height follows),
/// `search_rad` about the vertical axis, and 1 degree about the other axes.
MapRegistration register_maps(const PointMap& target, const PointMap& source, const Rigid3d& guess,
                              double search_m, double search_rad);

}  // namespace redrive
