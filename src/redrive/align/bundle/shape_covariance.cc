// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle/shape_covariance.h"

#include <Eigen/Dense>

#include "redrive/math/so3.h"

namespace redrive {
namespace {

/// Removes from the covariance C the rigid motions of the whole trajectory: returns P C P^T with P
/// = 1 - G (G^T W G)^-1 G^T W, where G is the derivative of the corrections by such a motion. W
/// weighs a rotation by the displacement it causes at 30 m, as register_trajectories does.
/// `scale_too` removes the scale as well, which without LiDAR is the egomotion's.
Eigen::MatrixXd without_common_motion(const RigModel& model, const Eigen::MatrixXd& covariance,
                                      bool scale_too) {
  constexpr double kArm_m = 30;
  const int n = static_cast<int>(model.initial_frames.size());
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const PosedFrame& frame : model.initial_frames)
    middle += frame.world_from_body.translation() / n;
  Eigen::MatrixXd g(6 * n, scale_too ? 7 : 6);
  Eigen::VectorXd weights(6 * n);
  for (int f = 0; f < n; ++f) {
    const Eigen::Matrix3d body_from_world =
        model.initial_frames[f].world_from_body.linear().transpose();
    g.block<3, 3>(6 * f, 0) = body_from_world;
    g.block<3, 3>(6 * f, 3) =
        -body_from_world * skew(model.initial_frames[f].world_from_body.translation() - middle);
    g.block<3, 3>(6 * f + 3, 0).setZero();
    g.block<3, 3>(6 * f + 3, 3) = body_from_world;
    if (scale_too) {
      g.block<3, 1>(6 * f, 6) =
          body_from_world * (model.initial_frames[f].world_from_body.translation() - middle);
      g.block<3, 1>(6 * f + 3, 6).setZero();
    }
    weights.segment<3>(6 * f).setOnes();
    weights.segment<3>(6 * f + 3).setConstant(kArm_m * kArm_m);
  }
  const Eigen::MatrixXd weighted = g.transpose() * weights.asDiagonal();
  const Eigen::MatrixXd solved = (weighted * g).ldlt().solve(weighted);  // [6 or 7, 6 n]
  const Eigen::MatrixXd half = covariance - g * (solved * covariance);
  return half - (half * solved.transpose()) * g.transpose();
}

}  // namespace

Eigen::VectorXd shape_variance(const RigModel& model, const BundleResult& bundle, bool scale_too) {
  const auto n = static_cast<Eigen::Index>(6 * model.initial_frames.size());
  const auto shape = [&](const Eigen::MatrixXd& covariance) {
    return Eigen::VectorXd(
        without_common_motion(model, covariance.topLeftCorner(n, n), scale_too).diagonal());
  };
  return shape(bundle.covariance).cwiseMax(shape(bundle.robust_covariance)).cwiseMax(0);
}

}  // namespace redrive
