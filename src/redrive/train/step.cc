// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/step.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "redrive/base/error.h"
#include "redrive/base/numbers.h"
#include "redrive/rays/error_map.h"

namespace redrive {
namespace {

/// Counts the parameters after a step in their mean. A run that goes on with a later end leaves the
/// stage whose steps count, and begins a new mean.
void add_to_mean(kernels::Backend& backend, double progress, TrainState* state) {
  const int every = state->model->average_every(progress);
  ParameterMean& mean = state->mean;
  if (every == 0) mean = {};
  if (every == 0 || state->step % every != 0) return;
  state->model->fetch(backend);
  const std::span<const float> added = state->model->parameters;
  if (mean.values.size() != added.size()) {
    REDRIVE_CHECK_OP(mean.steps, ==, 0);
    mean.values = Buffer<float>(added.size());
  }
  const float share = 1 / static_cast<float>(++mean.steps);
  constexpr std::size_t kNumbersPerRange = 1 << 16;
  backend.pool().run_ranges(added.size(), kNumbersPerRange,
                            [&](std::size_t begin, std::size_t end) {
                              for (std::size_t i = begin; i < end; ++i)
                                mean.values[i] += share * (added[i] - mean.values[i]);
                            });
}

}  // namespace

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
  add_to_mean(backend, request.progress, state);
}

void take_mean(kernels::Backend& backend, TrainState* state) {
  if (state->mean.steps == 0) return;
  state->model->fetch(backend);
  state->model->replace_parameters(std::move(state->mean.values));
  state->mean = {};
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
