// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/step.h"

#include <algorithm>
#include <cmath>
#include <span>

namespace redrive {
namespace {

constexpr double kShareSmoothing = 1.0 / 32;  // per step

/// A sampler's source as one backend keeps it.
template <class Spans>
void see(const GatherSource<Spans>& source, GatherSource<Spans>* own) {
  static_cast<Spans&>(*own) = source;
  own->pose_version = source.pose_version;
}

}  // namespace

void DeviceBatch::keep(kernels::Backend& backend, RayBatch* batch) {
  Room* room = rooms_;
  const auto keep = [&](auto& numbers) {
    using T = typename std::remove_reference_t<decltype(numbers)>::value_type;
    Room& kept = *room++;
    const std::size_t size = numbers.size();
    if (numbers.data() == kept.numbers && size <= kept.size) return;
    kept.there.reset();
    numbers.resize(numbers.capacity());
    kept = {numbers.data(), numbers.size(),
            backend.make_resident(kernels::as_floats(std::span<const T>(numbers)))};
    numbers.resize(size);
  };
  for (auto* const floats : {&batch->origin, &batch->direction, &batch->target, &batch->background,
                             &batch->pixel_angle, &batch->weight, &batch->range_m})
    keep(*floats);
  keep(batch->exposure);
  keep(batch->view);
  keep(batch->cell);
}

void gather_batch(kernels::Backend& backend, const PixelSampler& sampler, int even,
                  int error_map_rays, TrainState* state, RayBatch* batch, StepBuffers* buffers,
                  const Share& share) {
  const PixelSource& source = sampler.source();
  see(source, &buffers->pictures);
  // At the end of an epoch there are fewer, but one each at least: then the next epoch's first ones
  // are among them.
  const std::uint64_t of = share.of, rank = share.rank,
                      left = source.pixels - state->rays_drawn % source.pixels,
                      all = std::max(of, std::min(of * static_cast<std::uint64_t>(even), left)),
                      first = all * rank / of, next = all * (rank + 1) / of;
  const PixelDraw draw =
      sampler.draw(state->rays_drawn + first, static_cast<int>(next - first), error_map_rays);
  const GatheredRays room = sampler.resize_batch(draw, batch);
  batch->first_ray = first + rank * static_cast<std::uint64_t>(error_map_rays);
  buffers->batch.keep(backend, batch);
  kernels::make_resident(backend, state->cell_errors);
  backend.gather_pixels(buffers->pictures, draw, state->cell_errors, room);
}

void gather_lidar(kernels::Backend& backend, const LidarSampler& sampler, std::int64_t step, int n,
                  RayBatch* batch, StepBuffers* buffers) {
  see(sampler.source(), &buffers->returns);
  const GatheredReturns room = sampler.resize_batch(n, batch);
  buffers->lidar.keep(backend, batch);
  backend.gather_returns(buffers->returns, sampler.draw(step, n), room);
}

StepResult step_gradients(kernels::Backend& backend, const RayBatch& batch, const TrainState& state,
                          StepBuffers* buffers, const RayBatch* lidar) {
  const Model& model = *state.model;
  if (buffers->gradients.size() != model.size())
    buffers->gradients = Buffer<float>(model.size());  // zeros
  const std::span<float> gradients = buffers->gradients;
  kernels::make_resident(backend, buffers->gradients);
  kernels::make_resident(backend, state.first_moment);
  kernels::make_resident(backend, state.second_moment);
  Workspace& workspace = buffers->workspace;
  StepResult result;
  static_cast<StepOutput&>(result) =
      model.gradients(backend, batch, state.seed, state.step, gradients, &workspace);
  const bool ranges = lidar && lidar->n > 0;
  if (ranges) model.range_gradients(backend, *lidar, state.seed, state.step, gradients, &workspace);
  backend.not_finite(model.sentinels(gradients), &workspace.sums().not_finite);
  static_cast<LossTerms&>(result) = workspace.fetch_sums();
  if (!ranges) result.range = 0;  // an earlier step's
  result.loss = model.loss(result);
  result.finite = std::isfinite(result.loss + result.range) && result.not_finite == 0;
  if (batch.refines) {
    kernels::download(backend, batch.direction);
    kernels::download(backend, batch.view);
  }
  result.rays = batch.n;
  result.error_map_rays = batch.error_map_rays;
  return result;
}

void apply_step(kernels::Backend& backend, const StepResult& result,
                std::span<const std::uint32_t> cells, double learning_rate, TrainState* state,
                StepBuffers* buffers) {
  ++state->step;
  state->rays_drawn += static_cast<std::uint64_t>(result.rays - result.error_map_rays);
  if (!result.finite) return backend.fill(buffers->gradients, 0);
  Model& model = *state->model;
  backend.adam(model.adam(learning_rate, state->step), buffers->gradients, model.parameters,
               state->first_moment, state->second_moment);
  if (!cells.empty()) backend.update_error_map(cells, result.squares, state->cell_errors);
  if (result.active_rays > 0)
    state->active_fraction +=
        kShareSmoothing *
        (static_cast<double>(result.active_rays) / result.rays - state->active_fraction);
}

StepResult train_step(kernels::Backend& backend, const RayBatch& batch, double learning_rate,
                      TrainState* state, StepBuffers* buffers, const RayBatch* lidar) {
  const StepResult result = step_gradients(backend, batch, *state, buffers, lidar);
  apply_step(backend, result, batch.cell, learning_rate, state, buffers);
  return result;
}

}  // namespace redrive
