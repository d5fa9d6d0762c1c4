// SPDX-License-Identifier: Apache-2.0
// A training step: the method's losses and gradients, then Adam.
#pragma once

#include <functional>

#include "redrive/train/files/state.h"

namespace redrive {

struct StepResult : StepOutput {
  double opacity = 0, rgb_mse = 0;   ///< StepSums
  std::vector<LossTerm> loss_terms;  ///< Trainee::loss_terms
  double loss = 0;                   ///< sum of the terms with in_loss
  bool finite = true;                ///< false: the step is not applied
};

/// Returns the next step's request, without rank and world_size.
StepRequest next_step(const TrainState& state);

/// Returns what the next step updates itself, at this learning rate; empty parameters: nothing.
StepUpdate update_in_step(double learning_rate, TrainState* state);

/// Computes losses and gradients; adds them to buffers->gradients, which must be 0. `draw`:
/// Trainee::step of the state's model, or a part of it. `size`: number of gradients.
using DrawStep = std::function<StepOutput(std::span<float> gradients)>;
StepResult step_gradients(const TrainState& state, std::size_t size, StepBuffers* buffers,
                          const DrawStep& draw);
StepResult step_gradients(kernels::Backend& backend, const TrainingSet& data,
                          const StepRequest& request, const TrainState& state,
                          StepBuffers* buffers);

/// Applies a step to the state: counts it, updates the parameters, their mean and the error map.
/// Sets the gradients to 0. A step that is not finite changes nothing else.
void apply_step(kernels::Backend& backend, const StepRequest& request, const StepResult& result,
                double learning_rate, TrainState* state, StepBuffers* buffers);

/// Ends training with the mean of the parameters, if any step counts in it, and forgets the mean.
void take_mean(kernels::Backend& backend, TrainState* state);

/// Computes and applies a step on one backend.
StepResult train_step(kernels::Backend& backend, const TrainingSet& data,
                      const StepRequest& request, double learning_rate, TrainState* state,
                      StepBuffers* buffers);

}  // namespace redrive
