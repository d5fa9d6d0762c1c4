// SPDX-License-Identifier: Apache-2.0
// The covariance of the rig's parameters with all points and planes left free: the inverse of the Schur complement. (Ceres'
// own would invert the whole problem, in minutes.)
#pragma once

#include <vector>

#include <Eigen/Core>

namespace ceres {
class Problem;
}

namespace redrive {

/// [n, n] over the blocks `rig` in their order; the blocks `free`, of 3 numbers each, are eliminated: no residual may depend on
/// two of them. Robust losses count as weights. Nothing of a singular matrix is hidden: what the terms leave open is infinite (1e12).
Eigen::MatrixXd reduced_covariance(ceres::Problem& problem, const std::vector<double*>& rig,
                                   const std::vector<double*>& free);

}  // namespace redrive
