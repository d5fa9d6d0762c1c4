// SPDX-License-Identifier: Apache-2.0
// Residual terms of the bundle adjustment, as cost functions of Ceres with analytic Jacobians:
// reprojection error, point-to-plane distances of LiDAR and image points, and priors.
#pragma once

#include <array>
#include <memory>

#include <Eigen/Core>

#include "redrive/align/lidar/planes.h"
#include "redrive/align/rig/rig_model.h"
#include "redrive/recording/core/lidar_sensor.h"

namespace ceres {
class CostFunction;
}

namespace redrive {

/// A point of the scene by direction and inverse depth from an anchor (Civera, Davison, Montiel,
/// "Inverse depth parametrization for monocular SLAM", 2008), so that points at infinity constrain
/// the rotation: X = anchor + (d + x e1 + y e2) / z.
struct InverseDepthPoint {
  Eigen::Vector3d anchor = Eigen::Vector3d::Zero();    ///< in the world
  Eigen::Matrix3d axes = Eigen::Matrix3d::Identity();  ///< columns e1, e2, d: orthonormal
  std::array<double, 3> value{};                       ///< x, y, z (1/m)
};

/// A piece of a surface that the LiDAR measured, in the axes of the body at the time of the return.
struct SurfaceElement {
  Eigen::Vector3d in_body = Eigen::Vector3d::Zero(),
                  normal = Eigen::Vector3d::UnitZ();  ///< unit
  double sigma_m = 0;  ///< standard deviation of image points' distances from it
};

/// Stands for the residual where a camera does not see the point.
inline constexpr double kUnseen = 1000;

/// (projection - pixel) / sigma_px [2] of a point that `camera` observes. `motion`: around the time
/// of the pixel's row, with the camera's present offset_s and readout_s. Parameters: corrections
/// [6] [6] of the motion's two frames, extrinsics [6], time offset [1] and readout [1] (s),
/// intrinsics [3], point [3]. Where the camera does not see the point: kUnseen with zero Jacobians.
/// `camera` has to outlive the cost function.
std::unique_ptr<ceres::CostFunction> reprojection_cost(const RigModelCamera& camera,
                                                       const LocalMotion& motion,
                                                       const Eigen::Vector2d& pixel,
                                                       double sigma_px,
                                                       const InverseDepthPoint& point);

/// (n (X - centre) - h) / sigma_m [1] of a LiDAR point. Parameters: corrections [6] [6] of the
/// motion's two frames, plane [3], the angle [1] that raises the point.
std::unique_ptr<ceres::CostFunction> point_to_plane_cost(const LocalMotion& motion,
                                                         const RaisedReturn& in_body,
                                                         double sigma_m,
                                                         const PlaneParameters& plane);

/// normal (X - in_body) / sigma_m [1] of an image point X, in the axes of the body at the time of
/// `motion`. Parameters: corrections [6] [6] of the motion's two frames, point [3], whose inverse
/// depth has to be positive.
std::unique_ptr<ceres::CostFunction> point_on_surface_cost(const LocalMotion& motion,
                                                           const SurfaceElement& surface,
                                                           const InverseDepthPoint& point);

/// (x_k - expected) / sigma [1] of a block of `size` numbers.
std::unique_ptr<ceres::CostFunction> scalar_prior_cost(int size, int k, double sigma,
                                                       double expected = 0);
/// direction x / sigma [1].
std::unique_ptr<ceres::CostFunction> direction_prior_cost(const Vector6d& direction, double sigma);
/// x / sigmas [6].
std::unique_ptr<ceres::CostFunction> pose_prior_cost(const Vector6d& sigmas);
/// (b - a) / sigmas [6].
std::unique_ptr<ceres::CostFunction> smoothness_cost(const Vector6d& sigmas);

}  // namespace redrive
