// SPDX-License-Identifier: Apache-2.0
// One training step, from rays to Adam. Reads like section 5 of the paper.
#pragma once

#include <span>

#include "redrive/rays/ray_table.h"
#include "redrive/train/model.h"

namespace redrive {

/// Working memory of a step; grows to the largest batch seen.
struct StepBuffers {
  std::vector<float> t, dt, fine_t, fine_dt, rgb, fine_rgb, depth, opacity, weights, gradients;
};

struct StepResult {
  double loss = 0;     ///< what is optimised: coarse + fine photometric loss
  double rgb_mse = 0;  ///< of the finest network: what PSNR is said of
  double opacity = 0;  ///< mean over the batch, finest network: 0 means a dead field
  bool finite = true;  ///< false: the step was not applied
};

/// `state->step` counts on by one. Non-finite loss or gradients: parameters stay as they were.
StepResult train_step(kernels::Backend& backend, const RayBatch& batch, double learning_rate, TrainState* state,
                      StepBuffers* buffers);

}  // namespace redrive
