// SPDX-License-Identifier: Apache-2.0
// One training step, from rays to Adam.
#pragma once

#include "redrive/rays/ray_table.h"
#include "redrive/train/state.h"

namespace redrive {

/// Working memory of a step; grows to the largest batch seen.
struct StepBuffers {
  Workspace workspace;
  Buffer<float> gradients;
};

struct StepResult : StepLosses {
  bool finite = true;  ///< false: the step was not applied
};

/// A step has at most so many times the rays that the options say.
constexpr double kMostRaysOfBatch = 2;

/// Rays of a step, so that the field is asked about batch_rays of them: TrainState::field_share says how many are not empty.
inline int rays_of_step(int batch_rays, double field_share) {
  return static_cast<int>(batch_rays * (field_share * kMostRaysOfBatch > 1 ? 1 / field_share : kMostRaysOfBatch));
}

/// lidar: rays with ranges, or null. `state->step` counts on by one and rays_drawn by the even rays; where rays have
/// cells, their errors are taken in. Non-finite loss or gradients: parameters stay as they were.
StepResult train_step(kernels::Backend& backend, const RayBatch& batch, double learning_rate, TrainState* state,
                      StepBuffers* buffers, const RayBatch* lidar = nullptr);

}  // namespace redrive
