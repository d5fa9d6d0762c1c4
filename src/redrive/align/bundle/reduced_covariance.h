// SPDX-License-Identifier: Apache-2.0
// The covariance of the rig's parameters, marginalised over all points and planes: the inverse of
// the Schur complement. ceres::Covariance would take minutes for the whole problem.
#pragma once

#include <Eigen/Core>

#include "redrive/align/bundle/least_squares.h"
#include "redrive/base/parallel.h"

namespace redrive {

struct ReducedCovariance {
  /// [n, n], for independent residuals. Directions that no term constrains have a variance of 1e12.
  Eigen::MatrixXd matrix;
  /// [n, n], cluster-robust: the residuals of one landmark (a point or a plane) may be correlated,
  /// and so may the residuals of one group. H^-1 (H_0 + sum_b g_b g_b^T + sum_k g_k g_k^T) H^-1
  /// with g_b and g_k the gradients of the residuals of one landmark and of one group, landmarks
  /// eliminated, H_0 the normal matrix of residuals without a landmark, and H the curvature of the
  /// robust losses, which is less than their weights (Huber, "Robust Statistics", 1981: E psi^2 /
  /// (E psi')^2). Sums over blocks: Liang, Zeger, "Longitudinal data analysis using generalized
  /// linear models", 1986; over blocks and groups: Cameron, Gelbach, Miller, "Robust inference with
  /// multiway clustering", 2011, without their last term, the sum over parts of a landmark in a
  /// group, so that the matrix is positive; the variance of independent residuals is counted twice.
  /// Valid for parameters that many blocks and groups constrain; with few it is too small.
  Eigen::MatrixXd robust;
  Eigen::VectorXd variance;  ///< [n], the larger one of both diagonals
};

/// Covariance of the rig's numbers that are not held, at the present values. Robust losses count as
/// weights. A group (LeastSquares::Term) holds the residuals of one image, whose exposure, lens and
/// pose between two frames have errors of their own.
ReducedCovariance reduced_covariance(LeastSquares* problem, ThreadPool& pool);

}  // namespace redrive
