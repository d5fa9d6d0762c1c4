// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/step.h"

#include <cmath>
#include <span>

namespace redrive {
namespace {

constexpr double kShareSmoothing = 1.0 / 32;  // per step

}  // namespace

void KeptBatch::keep(kernels::Backend& backend, RayBatch* batch) {
  Room* room = rooms_;
  const auto keep = [&](auto& numbers) {
    using T = typename std::remove_reference_t<decltype(numbers)>::value_type;
    Room& kept = *room++;
    const std::size_t size = numbers.size();
    if (numbers.data() == kept.numbers && size <= kept.size) return;
    kept.there.reset();
    numbers.resize(numbers.capacity());
    kept = {numbers.data(), numbers.size(), backend.keep(kernels::as_floats(std::span<const T>(numbers)))};
    numbers.resize(size);
  };
  for (auto* const floats : {&batch->origin, &batch->direction, &batch->target, &batch->background, &batch->pixel_angle,
                             &batch->weight, &batch->range_m})
    keep(*floats);
  keep(batch->exposure);
  keep(batch->view);
  keep(batch->cell);
}

void gather_batch(kernels::Backend& backend, const PixelSampler& sampler, int even, int by_error, TrainState* state,
                  RayBatch* batch, StepBuffers* buffers) {
  const PixelDraw draw = sampler.draw(state->rays_drawn, even, by_error);
  const GatheredRays room = sampler.make_room(draw, batch);
  buffers->batch.keep(backend, batch);
  kernels::keep(backend, state->cell_errors);
  backend.gather(sampler.source(), draw, state->cell_errors, room);
}

void gather_lidar(kernels::Backend& backend, const LidarSampler& sampler, std::int64_t step, int n, RayBatch* batch,
                  StepBuffers* buffers) {
  const GatheredReturns room = sampler.make_room(n, batch);
  buffers->lidar.keep(backend, batch);
  backend.gather_lidar(sampler.source(), sampler.draw(step, n), room);
}

StepResult train_step(kernels::Backend& backend, const RayBatch& batch, double learning_rate, TrainState* state,
                      StepBuffers* buffers, const RayBatch* lidar) {
  Model& model = *state->model;
  if (buffers->gradients.size() != model.size()) buffers->gradients = Buffer<float>(model.size());  // zeros
  const std::span<float> gradients = buffers->gradients;
  for (const Buffer<float>* numbers : {&buffers->gradients, &state->first_moment, &state->second_moment})
    kernels::keep(backend, *numbers);
  Workspace& workspace = buffers->workspace;
  StepResult result;
  static_cast<StepLosses&>(result) = model.gradients(backend, batch, state->seed, state->step, gradients, &workspace);
  const bool ranges = lidar && lidar->n > 0;
  if (ranges) model.range_gradients(backend, *lidar, state->seed, state->step, gradients, &workspace);
  backend.not_finite(model.sentinels(gradients), &workspace.sums().not_finite);
  static_cast<StepSums&>(result) = workspace.fetch_sums();
  if (!ranges) result.range = 0;  // an earlier step's
  result.loss = model.loss(result);
  if (batch.refines) {
    kernels::fetch(backend, batch.direction);
    kernels::fetch(backend, batch.view);
  }
  ++state->step;
  state->rays_drawn += static_cast<std::uint64_t>(batch.n - batch.by_error);
  result.finite = std::isfinite(result.loss + result.range) && result.not_finite == 0;
  if (result.finite) {
    backend.adam(model.adam(learning_rate, state->step), gradients, model.parameters, state->first_moment,
                 state->second_moment);
    if (!batch.cell.empty()) backend.smooth_errors(batch.cell, result.squares, state->cell_errors);
    if (result.field_rays > 0)
      state->field_share += kShareSmoothing * (static_cast<double>(result.field_rays) / batch.n - state->field_share);
  } else {
    backend.fill(gradients, 0);
  }
  return result;
}

}  // namespace redrive
