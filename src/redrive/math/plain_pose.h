// SPDX-License-Identifier: Apache-2.0
// Poses as plain numbers: rigid transforms of rays, and interpolation of poses.
#pragma once

#include <cmath>

namespace redrive {

/// A Rigid3d (math/rigid3.h, plain): its rotation, row-major, its translation, and the rotation as
/// a unit quaternion x, y, z, w.
struct PlainPose {
  double rotation[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
  double translation[3] = {0, 0, 0};
  double quaternion[4] = {0, 0, 0, 1};
};

/// Returns coordinate k of the rotated vector, in Eigen's order of summation, which differs for the
/// third: bit for bit the same.
inline double rotated(const PlainPose& motion, const double* vector, int k) {
  const double x = motion.rotation[3 * k] * vector[0], y = motion.rotation[3 * k + 1] * vector[1],
               z = motion.rotation[3 * k + 2] * vector[2];
  return k < 2 ? (x + y) + z : x + (y + z);
}

/// Returns the dot product of quaternions, in Eigen's order of summation.
inline double quaternion_dot(const double* a, const double* b) {
  return (a[0] * b[0] + a[2] * b[2]) + (a[1] * b[1] + a[3] * b[3]);
}

/// Interpolates from a (fraction 0) to b (1), or extrapolates: linear in position, slerp in
/// rotation (Shoemake 1985).
inline PlainPose interpolate(const PlainPose& a, const PlainPose& b, double fraction) {
  constexpr double kSame = 1 - 0x1p-52;  // the sine of a smaller angle is 0
  const double cosine = quaternion_dot(a.quaternion, b.quaternion), least = std::fabs(cosine);
  double of_a = 1 - fraction, of_b = fraction;
  if (least < kSame) {
    const double angle = std::acos(least), sine = std::sin(angle);
    of_a = std::sin((1 - fraction) * angle) / sine;
    of_b = std::sin(fraction * angle) / sine;
  }
  if (cosine < 0) of_b = -of_b;
  PlainPose pose;
  double* const q = pose.quaternion;
  for (int i = 0; i < 4; ++i) q[i] = of_a * a.quaternion[i] + of_b * b.quaternion[i];
  const double length = std::sqrt(quaternion_dot(q, q));
  for (int i = 0; i < 4; ++i) q[i] /= length;
  for (int i = 0; i < 3; ++i)
    pose.translation[i] = a.translation[i] + fraction * (b.translation[i] - a.translation[i]);

  const double x = 2 * q[0], y = 2 * q[1], z = 2 * q[2];
  const double wx = x * q[3], wy = y * q[3], wz = z * q[3], xx = x * q[0], xy = y * q[0],
               xz = z * q[0], yy = y * q[1], yz = z * q[1], zz = z * q[2];
  const double rotation[9] = {1 - (yy + zz), xy - wz, xz + wy, xy + wz,      1 - (xx + zz),
                              yz - wx,       xz - wy, yz + wx, 1 - (xx + yy)};
  for (int i = 0; i < 9; ++i) pose.rotation[i] = rotation[i];
  return pose;
}

}  // namespace redrive
