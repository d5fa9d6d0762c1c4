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

/// lidar: rays with ranges, or null. `state->step` counts on by one and rays_drawn by the even rays; where rays have
/// cells, their errors are taken in. Non-finite loss or gradients: parameters stay as they were.
StepResult train_step(kernels::Backend& backend, const RayBatch& batch, double learning_rate, TrainState* state,
                      StepBuffers* buffers, const RayBatch* lidar = nullptr);

}  // namespace redrive
