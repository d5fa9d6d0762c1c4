// SPDX-License-Identifier: Apache-2.0
// Which clocks an adjusted rig does not tell. Straight on at one speed, a camera that exposes late
// sees what one further forward would: what is left of its clock's certainty comes from where the
// camera is said to be, from few points that other cameras see as well, and from what the tracks'
// errors have in common. Then the calibration's word is better than what fits best.
#pragma once

#include <vector>

#include "redrive/align/bundle/bundle_adjustment.h"

namespace redrive {

/// The largest standard deviation of a clock that is told: half of prior_s, the calibration's own,
/// so that most of what is known of it is the drive's.
inline double max_observable_sigma_s(double prior_s) { return prior_s / 2; }

/// Of the cameras with observations in `used` [cameras] and an offset in result.covariance those
/// whose clock the drive tells neither by itself nor against the mean of the others'. Told is what
/// is known so well, or what is three standard deviations from what is given; and what the LiDAR's
/// contrast has told (result.contrast). Without LiDAR nothing but the egomotion holds all clocks
/// together, and one camera's alone is right by definition.
std::vector<UnobservableTimeOffset> unobservable_time_offsets(const RigModel& model,
                                                              const BundleResult& result,
                                                              const std::vector<int>& used,
                                                              double prior_s, bool lidar);

}  // namespace redrive
