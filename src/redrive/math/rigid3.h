// SPDX-License-Identifier: Apache-2.0
// Rigid transforms are Eigen::Isometry3d, named a_from_b: x_in_a = a_from_b * x_in_b. Always
// double: ECEF coordinates are 4e6 m, where a float steps by 0.25 m.
#pragma once

#include <string>

#include <Eigen/Geometry>

#include "redrive/math/plain_pose.h"

namespace redrive {

using Rigid3d = Eigen::Isometry3d;
/// A small motion: translation x y z (m), then rotation vector (axis times angle, rad).
using Vector6d = Eigen::Matrix<double, 6, 1>;

PlainPose plain(const Rigid3d& pose);
Rigid3d rigid(const PlainPose& pose);

/// Interpolates from a (fraction 0) to b (1), or extrapolates: linear in position, slerp in
/// rotation (math/plain_pose.h).
Rigid3d interpolate(const Rigid3d& a, const Rigid3d& b, double fraction);

/// Returns why `matrix` is not a rigid transform ("det = -1, a reflection", "rows not orthonormal
/// by 0.02", ...), or an empty string. Tolerance: 1e-3 on R R^T - I (files carry 6 to 16 digits),
/// last row 0 0 0 1 to 1e-9.
std::string rigid_obstacle(const Eigen::Matrix4d& matrix);

}  // namespace redrive
