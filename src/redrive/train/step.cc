// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/step.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <span>

namespace redrive {
namespace {

constexpr double kShareSmoothing = 1.0 / 32;  // per step

bool all_finite(std::span<const float> values) {
  constexpr std::uint32_t kExponent = 0x7f800000;  // all ones: infinity or NaN
  std::uint32_t bad = 0;
  for (const float value : values) bad |= (std::bit_cast<std::uint32_t>(value) & kExponent) == kExponent;
  return bad == 0;
}

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
  const std::span<const float> sentinels = model.sentinels(gradients);
  backend.fetch(sentinels);
  result.finite = std::isfinite(result.loss + result.range) && all_finite(sentinels);
  if (result.finite) {
    backend.adam(model.adam(learning_rate, state->step), gradients, model.parameters, state->first_moment,
                 state->second_moment);
    if (!batch.cell.empty()) smooth_errors(batch.cell, result.squares, state->cell_errors);
    if (result.field_rays > 0)
      state->field_share += kShareSmoothing * (static_cast<double>(result.field_rays) / batch.n - state->field_share);
  } else {
    std::ranges::fill(gradients, 0.0f);
    backend.put(gradients);
  }
  return result;
}

}  // namespace redrive
