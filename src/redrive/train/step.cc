// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/step.h"

#include <cmath>
#include <span>

namespace redrive {
namespace {

constexpr double kShareSmoothing = 1.0 / 32;  // per step

}  // namespace

StepResult train_step(kernels::Backend& backend, const RayBatch& batch, double learning_rate, TrainState* state,
                      StepBuffers* buffers, const RayBatch* lidar) {
  Model& model = *state->model;
  if (buffers->gradients.size() != model.size()) buffers->gradients = Buffer<float>(model.size());  // zeros
  const std::span<float> gradients = buffers->gradients;
  for (const Buffer<float>* numbers : {&buffers->gradients, &state->first_moment, &state->second_moment})
    kernels::keep(backend, *numbers);
  StepResult result;
  static_cast<StepLosses&>(result) =
      model.gradients(backend, batch, state->seed, state->step, gradients, &buffers->workspace);
  if (lidar && lidar->n > 0)
    result.range = model.range_gradients(backend, *lidar, state->seed, state->step, gradients, &buffers->workspace);
  ++state->step;
  state->rays_drawn += static_cast<std::uint64_t>(batch.n - batch.by_error);
  result.finite = std::isfinite(result.loss + result.range) && backend.all_finite(model.sentinels(gradients));
  if (result.finite) {
    backend.adam(model.adam(learning_rate, state->step), gradients, model.parameters, state->first_moment,
                 state->second_moment);
    if (!batch.cell.empty()) smooth_errors(batch.cell, result.squares, state->cell_errors);
    if (result.field_rays > 0)
      state->field_share += kShareSmoothing * (static_cast<double>(result.field_rays) / batch.n - state->field_share);
  } else {
    backend.fill(gradients, 0);
  }
  return result;
}

}  // namespace redrive
