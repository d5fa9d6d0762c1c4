// SPDX-License-Identifier: Apache-2.0
// Decides which numbers of the cameras' extrinsics of an adjusted rig are unobservable, along and
// about the axes of the body. The images of one camera on a straight drive determine neither its
// rotation about the driving direction nor its position in the car. Their best fit then follows
// small errors that all observations share, which the residuals do not show; the calibration's
// value is better.
#pragma once

#include <vector>

#include "redrive/align/bundle/bundle_adjustment.h"

namespace redrive {

/// Forward, left, up (m), roll, pitch, yaw (rad) of a camera along and about the axes of the body.
inline constexpr int kExtrinsicAxes = 6;
const char* extrinsic_name(int axis);  ///< "forward", "left", "up", "roll", "pitch", "yaw"

/// The derivative of number `axis` by RigModelCamera::extrinsics.
Vector6d body_axis_of_extrinsics(const RigModelCamera& camera, int axis);

/// The camera's present correction in body axes.
Vector6d extrinsics_in_body(const RigModelCamera& camera);

/// Standard deviation of a number: min(sqrt(v + model_error^2), max(prior, |change|)) with v the
/// variance of the residuals, the larger of the independent one and the one correlated within a
/// point, patch, image or scan (ReducedCovariance::robust), and model_error the error that remains
/// however many residuals agree.
double extrinsic_sigma(const RigModel& model, const BundleResult& result, const Vector6d& prior,
                       int camera, int axis);

/// Error of a number from errors that all observations share, m or rad. The motion determines a
/// rotation about an axis by the car's rotations about others and by the distance driven across it,
/// a translation by rotations; ties to the LiDAR's surfaces determine both.
double model_error(const RigModel& model, int axis, int ties);

/// Error of a camera's position that all of its ties to the LiDAR's surfaces share, m; 0 where they
/// are too few to count.
double tie_error_m(int ties);

/// Returns the numbers of cameras with observations in `used` [cameras] that are observable neither
/// by themselves nor relative to the mean of the other cameras'. A number is observable if its
/// standard deviation is at most half of its prior's, or if it differs from its initial value by
/// three standard deviations of at most 0.1 degrees or 2 cm.
std::vector<UnobservableExtrinsic> unobservable_extrinsics(const RigModel& model,
                                                           const BundleResult& result,
                                                           const std::vector<int>& used,
                                                           const Vector6d& prior);

/// Resets the number to its initial value.
void reset_extrinsic(RigModelCamera* camera, int axis);

}  // namespace redrive
