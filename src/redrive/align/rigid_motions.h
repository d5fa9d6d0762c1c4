// SPDX-License-Identifier: Apache-2.0
// Rigid motions of parts of a trajectory, and covariances without the motion of the whole.
#pragma once

#include <vector>

#include <Eigen/Core>
#include <Eigen/Dense>

#include "redrive/math/rigid3.h"
#include "redrive/math/so3.h"

namespace redrive {

using Matrix6d = Eigen::Matrix<double, 6, 6>;

/// Derivative of a pose's error in body axes by a rigid motion of the world about `middle`.
inline Matrix6d by_motion(const Rigid3d& world_from_body, const Eigen::Vector3d& middle) {
  const Eigen::Matrix3d body_from_world = world_from_body.linear().transpose();
  Matrix6d g = Matrix6d::Zero();
  g.topLeftCorner<3, 3>() = body_from_world;
  g.topRightCorner<3, 3>() = -body_from_world * skew(world_from_body.translation() - middle);
  g.bottomRightCorner<3, 3>() = body_from_world;
  return g;
}

/// Weighs a pose's error: a rotation by the displacement that it causes at 30 m, as
/// register_trajectories does.
inline Vector6d motion_weights() {
  constexpr double kArm_m = 30;
  Vector6d w;
  w << 1, 1, 1, kArm_m * kArm_m, kArm_m * kArm_m, kArm_m * kArm_m;
  return w;
}

/// Removes a rigid motion of the whole from a covariance C of parts: (P C P^T)_kk with P = 1 - B
/// S^-1 B^T W, S = B^T W B. One entry per part: `effect` B of such a motion, `weighted` W B,
/// `shared` C W B. *covariance: C_kk.
inline void remove_common_motion(const std::vector<Matrix6d>& effect,
                                 const std::vector<Matrix6d>& weighted,
                                 const std::vector<Matrix6d>& shared,
                                 std::vector<Matrix6d>* covariance) {
  Matrix6d sum = Matrix6d::Zero(), common = Matrix6d::Zero();
  for (std::size_t k = 0; k < effect.size(); ++k) {
    sum += effect[k].transpose() * weighted[k];
    common += weighted[k].transpose() * shared[k];
  }
  const Matrix6d inverse_sum = sum.inverse();
  common = inverse_sum * common * inverse_sum;
  for (std::size_t k = 0; k < effect.size(); ++k) {
    const Matrix6d mixed = shared[k] * inverse_sum * effect[k].transpose();
    (*covariance)[k] += effect[k] * common * effect[k].transpose() - mixed - mixed.transpose();
  }
}

}  // namespace redrive
