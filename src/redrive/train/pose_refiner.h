// SPDX-License-Identifier: Apache-2.0
// Poses refined by what rays say of them, while a field is trained or after it: Adam over scene/pose_corrections.h.
#pragma once

#include <string>

#include "redrive/train/state.h"

namespace redrive {

/// How far corrections may go: what is further off wants redrive align, or is a mistake that no refinement should hide.
constexpr float kMostMoved_m = 0.5f, kMostTurned_rad = 0.035f, kMostLate_s = 0.05f;

/// What is refined, and how far a number may go in one update: metres, radians, seconds.
struct PoseRates {
  double by_m = 0, turn_rad = 0, time_s = 0;
  bool cameras = true;  ///< extrinsics and time offsets, too; else the frames alone
};

/// With `rate` m of place as the measure: a place that moves by x at 10 m moves pixels as far as a turn of x / 10 does, and a car at
/// 10 m/s is x further after x / 10 s.
PoseRates pose_rates(double rate_m);

/// By view of the scene: from the rays of a batch that says their views.
std::vector<ViewGradient> view_gradients(const Scene& scene, const RayBatch& batch, const StepLosses& losses);

/// One update, from a step's losses of a batch with views. `scene`: as placed by the state's corrections; the caller places it anew.
/// Frames without a picture that is trained on follow the others. Nothing changes where the losses are not finite.
void refine_poses(const Scene& scene, const RayBatch& batch, const StepLosses& losses, const PoseRates& rates,
                  PoseState* state);

/// What the corrections come to: a line for the trajectory and one for each camera, in cm, degrees and ms, with a warning where a number is at
/// its bound.
std::string describe_corrections(const Scene& scene, const PoseCorrections& corrections);

}  // namespace redrive
