// SPDX-License-Identifier: Apache-2.0
// The covariance of the rig's parameters with all points and planes left free: the inverse of the
// Schur complement. (Ceres' own would invert the whole problem, in minutes.)
#pragma once

#include <vector>

#include <Eigen/Core>

namespace ceres {
class Problem;
}

namespace redrive {

struct ReducedCovariance {
  /// [n, n], as if all residuals were independent. Nothing of a singular matrix is hidden: what the
  /// terms leave open is infinite (1e12).
  Eigen::MatrixXd matrix;
  /// [n], at least its diagonal: with the residuals of one free block, a point or a plane, as
  /// dependent as they are. H^-1 (H_0 + sum g g^T) H^-1 with g the gradient of one block's
  /// residuals, H_0 the normal matrix of residuals without any (Liang, Zeger, "Longitudinal data
  /// analysis using generalized linear models", 1986), and H the curvature that robust losses
  /// leave, which is less than their weights make it (Huber, "Robust Statistics", 1981: E psi^2 /
  /// (E psi')^2). For parameters that many blocks hold: few look as if they agreed too well.
  Eigen::VectorXd variance;
};

/// Over the blocks `rig` in their order; the blocks `free`, of 3 numbers each, are eliminated: no
/// residual may depend on two of them. Robust losses count as weights.
ReducedCovariance reduced_covariance(ceres::Problem& problem, const std::vector<double*>& rig,
                                     const std::vector<double*>& free);

}  // namespace redrive
