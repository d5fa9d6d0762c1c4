// SPDX-License-Identifier: Apache-2.0
// The fused stages' default: the composition of the plain ones.
#include <vector>

#include "redrive/kernels/check_sizes.h"
#include "redrive/kernels/kernels.h"

namespace redrive::kernels {

double Backend::train_rays(const NerfField& field, const Rays& rays, const Samples& samples,
                           std::span<const float> target, const CompositeOut& out, std::span<float> gradients,
                           const RayGradients& of_rays) {
  check_field(field, rays, samples);
  std::vector<float> raw(4 * sample_count(rays.n, samples)), d_raw(raw.size()),
      d_rgb(3 * static_cast<std::size_t>(rays.n));
  nerf_forward(field, rays, samples, raw);
  composite_forward(rays.n, samples, raw, {}, out);
  const double loss = photometric_loss(out.rgb, target, d_rgb);
  composite_backward(rays.n, samples, raw, {}, {d_rgb, {}}, d_raw);
  nerf_backward(field, rays, samples, d_raw, gradients, of_rays);
  return loss;
}

void Backend::render_rays(const NerfField& field, const Rays& rays, const Samples& samples, const CompositeOut& out) {
  check_field(field, rays, samples);
  std::vector<float> raw(4 * sample_count(rays.n, samples));
  nerf_forward(field, rays, samples, raw);
  composite_forward(rays.n, samples, raw, {}, out);
}

}  // namespace redrive::kernels
