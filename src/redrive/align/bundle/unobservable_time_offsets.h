// SPDX-License-Identifier: Apache-2.0
// Decides which time offsets of an adjusted rig are unobservable. At constant velocity a camera
// that exposes late sees the same as a camera further forward. Its offset is then determined by the
// prior of the camera's position, by few points that other cameras see, and by errors that its
// tracks share; the calibration's value is better than the best fit.
#pragma once

#include <optional>
#include <vector>

#include "redrive/align/bundle/bundle_adjustment.h"

namespace redrive {

/// The largest standard deviation of an observable time offset: half of prior_s, the calibration's
/// own, so that the drive contributes most of the information.
inline double max_observable_sigma_s(double prior_s) { return prior_s / 2; }

/// Standard deviation of a camera's time offset: min(sqrt(v + (m / speed)^2), max(prior_s,
/// |change|)) with v its variance by the residuals (BundleResult::variance), m the error of
/// positions that all of the camera's ties to the LiDAR's surfaces share (tie_error_m), and the
/// mean speed of the drive. Nothing where the offset was not estimated.
std::optional<double> time_offset_sigma(const RigModel& model, const BundleResult& result,
                                        double prior_s, int camera);

/// Returns the cameras with observations in `used` [cameras] and an offset in result.covariance
/// whose time offset is observable neither by itself nor relative to the mean of the others'. An
/// offset is observable if its standard deviation is at most max_observable_sigma_s, if it differs
/// from its initial value by three standard deviations, or if LiDAR contrast determined it
/// (result.contrast). Without LiDAR only the egomotion ties the offsets to an absolute time, and
/// the offset of a single camera counts as observable.
std::vector<UnobservableTimeOffset> unobservable_time_offsets(const RigModel& model,
                                                              const BundleResult& result,
                                                              const std::vector<int>& used,
                                                              double prior_s, bool lidar);

}  // namespace redrive
