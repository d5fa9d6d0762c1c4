// SPDX-License-Identifier: Apache-2.0
// Refines poses by the gradients of rays, during training or after it: Adam over the corrections of
// scene/pose_corrections.h.
#pragma once

#include <functional>

#include "redrive/train/files/state.h"
#include "redrive/train/poses/pose_refinement.h"

namespace redrive {

/// Returns the bound of value i.
float bound_of(const PoseBounds& bounds, const PoseCorrections& corrections, std::size_t i);

/// Learning rates for metres, radians and seconds.
struct PoseRates {
  double translation_rate_m = 0, rotation_rate_rad = 0, time_s = 0;
};

/// Returns rates in proportion to `rate_m`: a translation by x moves the image of a point at 10 m
/// as far as a rotation by x / 10, and a car at 10 m/s travels x in x / 10 s.
PoseRates pose_rates(double rate_m);

/// Applies one Adam update to `values`; rate_of(i): learning rate of the i-th.
void update_poses(std::span<const double> gradient,
                  const std::function<double(std::size_t i)>& rate_of, std::span<float> values,
                  AdamMoments* moments);

/// Applies one update by a step's StepOutput::views. `scene`: with the state's corrections applied;
/// the caller applies the new ones. Removes the mean correction of
/// all cameras, which the frames represent. Interpolates frames without a training image. Does
/// nothing where gradients are not finite.
void refine_poses(const Scene& scene, std::span<const ViewGradient> views, const PoseRates& rates,
                  const PoseRefinement& refinement, PoseState* state);

}  // namespace redrive
