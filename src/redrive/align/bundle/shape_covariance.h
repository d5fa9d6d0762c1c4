// SPDX-License-Identifier: Apache-2.0
// How precisely a bundle adjustment determines the trajectory's shape.
#pragma once

#include <Eigen/Core>

#include "redrive/align/bundle/bundle_adjustment.h"

namespace redrive {

/// Variances of the pose corrections [6 frames] without a rigid motion of the whole trajectory,
/// which nothing measures: the larger of BundleResult::covariance and robust_covariance.
/// `scale_too`: without the scale as well, which without LiDAR is the egomotion's.
Eigen::VectorXd shape_variance(const RigModel& model, const BundleResult& bundle, bool scale_too);

}  // namespace redrive
