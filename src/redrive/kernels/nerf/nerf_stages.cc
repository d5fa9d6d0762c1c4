// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/nerf/nerf_stages.h"

#include "redrive/kernels/nerf/check_nerf_sizes.h"

namespace redrive::kernels {

std::span<float> NerfStages::scratch(Buffer<float>* buffer, std::size_t n) {
  if (buffer->size() < n) *buffer = Buffer<float>(n);
  return buffer->span().first(n);
}

void NerfStages::train_rays(const NerfField& field, const Rays& rays, const Samples& samples,
                            std::span<const float> target, const CompositeOut& out,
                            std::span<float> gradients, const RayGradients& of_rays, double* loss) {
  check_field(field, rays, samples);
  const std::size_t n = sample_count(rays.n, samples);
  const auto raw = scratch(&raw_, 4 * n), d_raw = scratch(&d_raw_, 4 * n),
             d_rgb = scratch(&d_rgb_, 3 * static_cast<std::size_t>(rays.n));
  network_forward(field, rays, samples, raw);
  backend_.composite_forward(rays.n, samples, raw, {}, out);
  backend_.photometric_loss(out.rgb, target, d_rgb, loss);
  backend_.composite_backward(rays.n, samples, raw, {}, {d_rgb, {}}, d_raw);
  network_backward(field, rays, samples, d_raw, gradients, of_rays);
}

void NerfStages::render_rays(const NerfField& field, const Rays& rays, const Samples& samples,
                             const CompositeOut& out) {
  check_field(field, rays, samples);
  const auto raw = scratch(&raw_, 4 * sample_count(rays.n, samples));
  network_forward(field, rays, samples, raw);
  backend_.composite_forward(rays.n, samples, raw, {}, out);
}

}  // namespace redrive::kernels
