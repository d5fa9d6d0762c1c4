// SPDX-License-Identifier: Apache-2.0
// Poses refined by what rays say of them, while a field is trained or after it: Adam over
// scene/pose_corrections.h.
#pragma once

#include <functional>

#include "redrive/train/state.h"

namespace redrive {

/// How far corrections may go: what is further off wants redrive align, or is a mistake that no
/// refinement should hide.
constexpr float kMaxTranslation_m = 0.5f, kMaxRotation_rad = 0.035f, kMaxTimeOffset_s = 0.05f;
/// That of number i.
float bound_of(const PoseCorrections& corrections, std::size_t i);

/// How far one update may move what is of metres, radians and seconds.
struct PoseRates {
  double translation_rate_m = 0, rotation_rate_rad = 0, time_s = 0;
};

/// With `rate_m` of place as the measure: a place that moves by x moves what is seen at 10 m as far
/// as a turn of x / 10 does, and a car at 10 m/s is x further after x / 10 s.
PoseRates pose_rates(double rate_m);

/// One update of numbers by their gradients; rate_of(i): of the i-th.
void update_poses(std::span<const double> gradient,
                  const std::function<double(std::size_t i)>& rate_of, std::span<float> values,
                  AdamMoments* moments);

/// By view of the scene: from the rays of a batch that says their views.
std::vector<ViewGradient> view_gradients(const Scene& scene, const RayBatch& batch,
                                         const StepOutput& losses);

/// One update, from a step's view_gradients. `scene`: as placed by the state's corrections; the
/// caller places it anew. What all cameras have in common, of place, turn and time, is the frames'
/// to say: it is taken from the cameras. Frames without a picture that is trained on follow the
/// others. Nothing changes where the gradients are not finite.
void refine_poses(const Scene& scene, std::span<const ViewGradient> views, const PoseRates& rates,
                  PoseState* state);

}  // namespace redrive
