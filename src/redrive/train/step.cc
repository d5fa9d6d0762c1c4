// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/step.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include "redrive/base/rng.h"

namespace redrive {
namespace {

bool all_finite(std::span<const float> values) {
  constexpr std::uint32_t kExponent = 0x7f800000;  // all ones: infinity or NaN
  std::uint32_t bad = 0;
  for (const float value : values) bad |= (std::bit_cast<std::uint32_t>(value) & kExponent) == kExponent;
  return bad == 0;
}

std::span<float> sized(std::vector<float>* buffer, std::size_t size) {
  if (buffer->size() < size) buffer->resize(size);
  return {buffer->data(), size};
}

}  // namespace

StepResult train_step(kernels::Backend& backend, const RayBatch& batch, double learning_rate, TrainState* state,
                      StepBuffers* buffers) {
  const NerfModel& model = state->model;
  const std::size_t n = batch.n, coarse = n * model.samples, fine = n * (model.samples + model.fine_samples);
  const std::size_t parameters = nerf_parameter_count(model.config);
  const kernels::Rays rays{batch.n, std::span(batch.origin).first(3 * n), std::span(batch.direction).first(3 * n)};
  const auto target = std::span(batch.target).first(3 * n);
  const auto gradients = sized(&buffers->gradients, model.parameters.size());
  const auto opacity = sized(&buffers->opacity, n), depth = sized(&buffers->depth, n);
  std::ranges::fill(gradients, 0.0f);

  // Section 4: stratified samples, the field at each, the colour of the ray (eq. 3), its squared error, and back.
  const auto t = sized(&buffers->t, coarse), dt = sized(&buffers->dt, coarse);
  const auto weights = sized(&buffers->weights, model.fine_samples > 0 ? coarse : 0);
  backend.sample_stratified(
      batch.n, {model.samples, model.near_m, model.far_m, true, random_key(state->seed, kStreamSamples, state->step)},
      t, dt);
  const kernels::Samples samples{model.samples, t, dt};
  StepResult result;
  result.rgb_mse =
      backend.train_rays(model.field(0), rays, samples, target, {sized(&buffers->rgb, 3 * n), depth, opacity, weights},
                         gradients.first(parameters));
  result.loss = result.rgb_mse;

  // Section 5.2: further samples where the coarse network found matter, seen by the fine network.
  if (model.fine_samples > 0) {
    const auto fine_t = sized(&buffers->fine_t, fine), fine_dt = sized(&buffers->fine_dt, fine);
    backend.sample_hierarchical(samples, weights, model.fine_samples, true,
                                random_key(state->seed, kStreamFineSamples, state->step), fine_t, fine_dt);
    result.rgb_mse =
        backend.train_rays(model.field(1), rays, {model.samples + model.fine_samples, fine_t, fine_dt}, target,
                           {sized(&buffers->fine_rgb, 3 * n), depth, opacity, {}}, gradients.last(parameters));
    result.loss += result.rgb_mse;
  }
  for (const float value : opacity) result.opacity += value / static_cast<double>(n);

  ++state->step;
  result.finite = std::isfinite(result.loss) && all_finite(gradients);
  if (result.finite)
    backend.adam(adam_step(learning_rate, state->step), gradients, state->model.parameters, state->first_moment,
                 state->second_moment);
  return result;
}

}  // namespace redrive
