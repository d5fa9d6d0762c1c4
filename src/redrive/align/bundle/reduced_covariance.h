// SPDX-License-Identifier: Apache-2.0
// The covariance of the rig's parameters, marginalised over all points and planes: the inverse of
// the Schur complement. ceres::Covariance would take minutes for the whole problem.
#pragma once

#include <unordered_map>
#include <vector>

#include <ceres/problem.h>
#include <Eigen/Core>

#include "redrive/base/parallel.h"

namespace redrive {

struct ReducedCovariance {
  /// [n, n], for independent residuals. Directions that no term constrains have a variance of 1e12.
  Eigen::MatrixXd matrix;
  /// [n, n], cluster-robust: the residuals of one free block (a point or a plane) may be
  /// correlated, and so may the residuals of one group. H^-1 (H_0 + sum_b g_b g_b^T + sum_k g_k
  /// g_k^T) H^-1 with g_b and g_k the gradients of the residuals of one block and of one group,
  /// free blocks eliminated, H_0 the normal matrix of residuals without a free block, and H the
  /// curvature of the robust losses, which is less than their weights (Huber, "Robust Statistics",
  /// 1981: E psi^2 / (E psi')^2). Sums over blocks: Liang, Zeger, "Longitudinal data analysis using
  /// generalized linear models", 1986; over blocks and groups: Cameron, Gelbach, Miller, "Robust
  /// inference with multiway clustering", 2011, without their last term, the sum over parts of a
  /// block in a group, so that the matrix is positive; the variance of independent residuals is
  /// counted twice. Valid for parameters that many blocks and groups constrain; with few it is too
  /// small.
  Eigen::MatrixXd robust;
  Eigen::VectorXd variance;  ///< [n], the larger one of both diagonals
};

/// Groups of residuals with a free block, from 0. A group holds the residuals of one image, whose
/// exposure, lens and pose between two frames have errors of their own.
using ResidualGroups = std::unordered_map<ceres::ResidualBlockId, int>;

/// Covariance of the blocks `rig` in their order. The blocks `free`, of 3 numbers each, are
/// eliminated; no residual may depend on two of them. Robust losses count as weights. A
/// residual that is missing in `groups` has no group.
ReducedCovariance reduced_covariance(ceres::Problem& problem, const std::vector<double*>& rig,
                                     const std::vector<double*>& free, ThreadPool& pool,
                                     const ResidualGroups& groups = {});

}  // namespace redrive
