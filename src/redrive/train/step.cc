// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/step.h"

#include <cmath>

namespace redrive {

StepRequest next_step(const TrainState& state) {
  StepRequest request;
  request.seed = state.seed;
  request.step = state.step;
  request.pixels_drawn = state.pixels_drawn;
  request.error_map = &state.cell_errors;
  return request;
}

StepUpdate update_in_step(double learning_rate, TrainState* state) {
  if (state->model->updated_in_step() == 0) return {};
  return {learning_rate, state->step + 1, state->model->parameters, &state->adam};
}

StepResult step_gradients(kernels::Backend& backend, const TrainState& state, std::size_t size,
                          StepBuffers* buffers, const DrawStep& draw) {
  const Model& model = *state.model;
  if (buffers->gradients.size() != size) {
    buffers->gradients = {};                   // not both at once
    buffers->gradients = Buffer<float>(size);  // zeros
  }
  const std::span<float> gradients = buffers->gradients;
  kernels::make_resident(backend, buffers->gradients);
  kernels::make_resident(backend, state.adam.first_moment);
  kernels::make_resident(backend, state.adam.second_moment);
  Workspace& workspace = buffers->workspace;
  StepResult result;
  static_cast<StepOutput&>(result) = draw(gradients);
  backend.not_finite(model.sentinels(gradients), &workspace.sums().not_finite);
  const StepSums& sums = workspace.fetch_sums();
  result.opacity = sums.opacity;
  result.rgb_mse = sums.rgb_mse;
  result.loss_terms = model.loss_terms(sums);
  double all = 0;
  for (const LossTerm& term : result.loss_terms) {
    all += term.value;
    if (term.in_loss) result.loss += term.value;
  }
  result.finite = std::isfinite(all) && sums.not_finite == 0;
  return result;
}

StepResult step_gradients(kernels::Backend& backend, const TrainingSet& data,
                          const StepRequest& request, const TrainState& state,
                          StepBuffers* buffers) {
  const std::size_t updated = request.update ? state.model->updated_in_step() : 0,
                    size = state.model->size() - updated;
  return step_gradients(backend, state, size, buffers, [&](std::span<float> gradients) {
    return state.model->step(backend, data, request, gradients, buffers);
  });
}

void apply_step(kernels::Backend& backend, const StepRequest& request, const StepResult& result,
                double learning_rate, TrainState* state, StepBuffers* buffers) {
  ++state->step;
  state->pixels_drawn += static_cast<std::uint64_t>(result.epoch_pixels);
  if (!result.finite) return backend.fill(buffers->gradients, 0);
  Model& model = *state->model;
  model.update(backend, learning_rate, state->step, buffers->gradients, &state->adam);
  if (!result.cells.empty())
    backend.update_error_map(result.cells, result.squared_errors, state->cell_errors);
  model.finish_step(backend, request, result, state->step, &state->adam);
}

StepResult train_step(kernels::Backend& backend, const TrainingSet& data,
                      const StepRequest& request, double learning_rate, TrainState* state,
                      StepBuffers* buffers) {
  StepRequest updating = request;
  const StepUpdate update = update_in_step(learning_rate, state);
  if (!update.parameters.empty()) updating.update = &update;
  const StepResult result = step_gradients(backend, data, updating, *state, buffers);
  apply_step(backend, request, result, learning_rate, state, buffers);
  return result;
}

}  // namespace redrive
