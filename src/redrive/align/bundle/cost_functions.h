// SPDX-License-Identifier: Apache-2.0
// The terms that align minimises, as cost functions of Ceres with analytic Jacobians: an image
// point, a LiDAR point on a plane, and what was known before.
#pragma once

#include <array>
#include <memory>

#include <Eigen/Core>

#include "redrive/align/rig/rig_model.h"

namespace ceres {
class CostFunction;
}

namespace redrive {

/// A point of the scene by direction and inverse distance from an anchor, so that what is too far
/// to have a distance still holds the rotation: X = anchor + (d + x e1 + y e2) / z, at infinity for
/// z = 0.
struct InverseDepthPoint {
  Eigen::Vector3d anchor = Eigen::Vector3d::Zero();    ///< in the world
  Eigen::Matrix3d axes = Eigen::Matrix3d::Identity();  ///< columns e1, e2, d: orthonormal
  std::array<double, 3> value{};                       ///< x, y, z (1/m)
};

/// n (X - centre) = h with n = axes (x, y, 1): a plane near `centre`, whose normal differs little
/// from axes.col(2).
struct PlaneParameters {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  Eigen::Matrix3d axes = Eigen::Matrix3d::Identity();
  std::array<double, 3> value{};  ///< x, y, h (m)
};

/// What stands for the residual where a camera does not see the point.
inline constexpr double kUnseen = 1000;

/// (projection - pixel) / sigma_px [2] of a point that `camera` saw at `instant`, its row's own.
/// Parameters: corrections [6] [6] of the instant's two frames, mount [6], time offset [1] and
/// readout [1] (s; they were offset_s and readout_s at the instant), intrinsics [3], point [3].
/// Where the camera does not see the point: kUnseen without slope. `camera` has to outlive the
/// term.
std::unique_ptr<ceres::CostFunction> reprojection_cost(const RigModelCamera& camera,
                                                       const Instant& instant,
                                                       const Eigen::Vector2d& pixel,
                                                       double sigma_px,
                                                       const InverseDepthPoint& point);

/// n (X - centre) - h over sigma_m [1] for a LiDAR point. Parameters: corrections [6] [6] of the
/// instant's two frames, plane [3].
std::unique_ptr<ceres::CostFunction> point_to_plane_cost(const Instant& instant,
                                                         const Eigen::Vector3d& in_body,
                                                         double sigma_m,
                                                         const PlaneParameters& plane);

/// x_k / sigma [1] for the k-th of `size` numbers.
std::unique_ptr<ceres::CostFunction> scalar_prior_cost(int size, int k, double sigma,
                                                       double expected = 0);
/// x / sigmas [6].
std::unique_ptr<ceres::CostFunction> pose_prior_cost(const Vector6d& sigmas);
/// (b - a) / sigmas [6].
std::unique_ptr<ceres::CostFunction> smoothness_cost(const Vector6d& sigmas);

}  // namespace redrive
