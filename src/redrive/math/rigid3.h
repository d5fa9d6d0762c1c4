// SPDX-License-Identifier: Apache-2.0
// Rigid transforms are Eigen::Isometry3d, named a_from_b: x_in_a = a_from_b * x_in_b. Always
// double: ECEF coordinates are 4e6 m, where a float steps by 0.25 m.
#pragma once

#include <string>

#include <Eigen/Geometry>

#include "redrive/math/plain_pose.h"

namespace redrive {

using Rigid3d = Eigen::Isometry3d;

PlainPose plain(const Rigid3d& pose);
Rigid3d rigid(const PlainPose& pose);

/// `part` of the way from a (0) to b (1), or beyond: straight on, along the shortest turn
/// (math/plain_pose.h).
Rigid3d between(const Rigid3d& a, const Rigid3d& b, double part);

/// Why `matrix` is not a rigid transform ("det = -1: a reflection", "rows not orthonormal by 0.02",
/// ...), or empty. Tolerance: 1e-3 on R R^T - I (files carry 6 to 16 digits), last row 0 0 0 1 to
/// 1e-9.
std::string rigid_obstacle(const Eigen::Matrix4d& matrix);

}  // namespace redrive
