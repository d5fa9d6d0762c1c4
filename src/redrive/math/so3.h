// SPDX-License-Identifier: Apache-2.0
// Rotation vectors (axis times angle, radians), their exponential map, logarithm and right
// Jacobian. Formulas: Sola, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics"
// (arXiv:1812.01537), appendix B.
#pragma once

#include <cmath>

#include "redrive/math/rigid3.h"

namespace redrive {

/// skew(a) b = a x b.
inline Eigen::Matrix3d skew(const Eigen::Vector3d& a) {
  Eigen::Matrix3d m;
  m << 0, -a.z(), a.y(), a.z(), 0, -a.x(), -a.y(), a.x(), 0;
  return m;
}

/// The rotation about `v` by |v| radians; the identity at 0.
inline Eigen::Matrix3d so3_exp(const Eigen::Vector3d& v) {
  const double angle = v.norm();
  if (angle < 1e-12) return Eigen::Matrix3d::Identity() + skew(v);
  return Eigen::AngleAxisd(angle, v / angle).toRotationMatrix();
}

/// The inverse of so3_exp, |v| <= pi.
inline Eigen::Vector3d so3_log(const Eigen::Matrix3d& rotation) {
  const Eigen::AngleAxisd turn(rotation);
  return turn.angle() * turn.axis();
}

/// so3_exp(v + e) = so3_exp(v) so3_exp(J e) to first order in e. Below 1e-4 rad by the series, with
/// an error of |v|^3 / 24.
inline Eigen::Matrix3d so3_right_jacobian(const Eigen::Vector3d& v) {
  const double aa = v.squaredNorm(), angle = std::sqrt(aa);
  const Eigen::Matrix3d m = skew(v);
  if (angle < 1e-4) return Eigen::Matrix3d::Identity() - 0.5 * m + m * m / 6;
  return Eigen::Matrix3d::Identity() - (1 - std::cos(angle)) / aa * m +
         (angle - std::sin(angle)) / (aa * angle) * m * m;
}

/// The motion of a Vector6d: a_from_b * rigid_from_vector(v) moves b in its own axes.
inline Rigid3d rigid_from_vector(const Vector6d& v) {
  Rigid3d motion = Rigid3d::Identity();
  motion.linear() = so3_exp(v.tail<3>());
  motion.translation() = v.head<3>();
  return motion;
}

}  // namespace redrive
