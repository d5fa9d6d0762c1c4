// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/step.h"

#include <algorithm>
#include <cmath>

#include "redrive/base/numbers.h"
#include "redrive/rays/error_map.h"

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

StepResult step_gradients(const TrainState& state, std::size_t size, StepBuffers* buffers,
                          const DrawStep& draw) {
  const Trainee& model = *state.model;
  if (buffers->gradients.size() != size) {
    buffers->gradients = {};                   // not both at once
    buffers->gradients = Buffer<float>(size);  // zeros
  }
  const std::span<float> gradients = buffers->gradients;
  StepResult result;
  static_cast<StepOutput&>(result) = draw(gradients);
  const StepSums& sums = buffers->workspace.sums();
  result.opacity = sums.opacity;
  result.rgb_mse = sums.rgb_mse;
  result.loss_terms = model.loss_terms(sums);
  double all = 0;
  for (const LossTerm& term : result.loss_terms) {
    all += term.value;
    if (term.in_loss) result.loss += term.value;
  }
  result.finite = std::isfinite(all) && all_finite(model.sentinels(gradients));
  return result;
}

StepResult step_gradients(kernels::Backend& backend, const TrainingSet& data,
                          const StepRequest& request, const TrainState& state,
                          StepBuffers* buffers) {
  const std::size_t size = state.model->gradients_size(request.update != nullptr);
  return step_gradients(state, size, buffers, [&](std::span<float> gradients) {
    return state.model->step(backend, data, request, gradients, buffers);
  });
}

void apply_step(kernels::Backend& backend, const StepRequest& request, const StepResult& result,
                double learning_rate, TrainState* state, StepBuffers* buffers) {
  ++state->step;
  state->pixels_drawn += static_cast<std::uint64_t>(result.epoch_pixels);
  if (!result.finite) {
    std::ranges::fill(buffers->gradients.span(), 0.0f);
    return;
  }
  Trainee& model = *state->model;
  model.update(backend, learning_rate, state->step, buffers->gradients, &state->adam);
  if (!result.cells.empty())
    update_error_map(result.cells, result.squared_errors, state->cell_errors);
  model.finish_step(backend, request, result, state->step, *buffers, &state->adam);
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
