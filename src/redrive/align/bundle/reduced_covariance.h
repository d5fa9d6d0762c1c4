// SPDX-License-Identifier: Apache-2.0
// The covariance of the rig's parameters, marginalised over all points and planes: the inverse of
// the Schur complement. ceres::Covariance would take minutes for the whole problem.
#pragma once

#include <vector>

#include <Eigen/Core>

namespace ceres {
class Problem;
}

namespace redrive {

struct ReducedCovariance {
  /// [n, n], for independent residuals. Directions that no term constrains have a variance of 1e12.
  Eigen::MatrixXd matrix;
  /// [n, n], cluster-robust: the residuals of one free block (a point or a plane) may be
  /// correlated. H^-1 (H_0 + sum g g^T) H^-1 with g the gradient of one block's residuals, H_0 the
  /// normal matrix of residuals without a free block (Liang, Zeger, "Longitudinal data analysis
  /// using generalized linear models", 1986), and H the curvature of the robust losses, which is
  /// less than their weights (Huber, "Robust Statistics", 1981: E psi^2 / (E psi')^2). Valid for
  /// parameters that many blocks constrain; with few blocks it is too small.
  Eigen::MatrixXd robust;
  Eigen::VectorXd variance;  ///< [n], the larger one of both diagonals
};

/// Covariance of the blocks `rig` in their order. The blocks `free`, of 3 numbers each, are
/// eliminated; no residual may depend on two of them. Robust losses count as weights.
ReducedCovariance reduced_covariance(ceres::Problem& problem, const std::vector<double*>& rig,
                                     const std::vector<double*>& free);

}  // namespace redrive
