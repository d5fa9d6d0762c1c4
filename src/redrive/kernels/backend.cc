// SPDX-License-Identifier: Apache-2.0
// Defaults: what is done to numbers on the host, and the fused stages as the composition of the
// plain ones.
#include <algorithm>
#include <bit>
#include <cstdint>
#include <numeric>

#include "redrive/kernels/backend.h"
#include "redrive/kernels/check_sizes.h"
#include "redrive/kernels/host_image_score.h"

namespace redrive::kernels {

void Backend::fill(std::span<float> numbers, float value) { std::ranges::fill(numbers, value); }

void Backend::mean(std::span<const float> numbers, double* mean) {
  REDRIVE_CHECK_OP(numbers.size(), >, 0u);
  *mean =
      std::accumulate(numbers.begin(), numbers.end(), 0.0) / static_cast<double>(numbers.size());
}

void Backend::not_finite(std::span<const float> numbers, double* count) {
  constexpr std::uint32_t kExponent = 0x7f800000;  // all ones: infinity or NaN
  std::uint32_t bad = 0;
  for (const float number : numbers)
    bad |= (std::bit_cast<std::uint32_t>(number) & kExponent) == kExponent;
  *count = bad;
}

void Backend::gather(const PixelSource& from, const PixelDraw& draw, std::span<const float> errors,
                     const GatheredRays& out) {
  check_gather(from, draw, errors.size(), out);
  gather_pixels(from, draw, errors, out);
}

void Backend::gather_lidar(const LidarSource& from, const LidarDraw& draw,
                           const GatheredReturns& out) {
  check_gather_lidar(from, out);
  gather_returns(from, draw, out);
}

void Backend::update_error_map(std::span<const std::uint32_t> cells, std::span<const float> squares,
                               std::span<float> errors) {
  redrive::update_error_map(cells, squares, errors);
}

ImageScore Backend::score(const ImagePair& pictures) {
  ThreadPool one(1);
  return score_on_host(pictures, one);
}

std::span<float> Backend::scratch_between_stages(int which, std::size_t n) {
  Buffer<float>& room = scratch_between_stages_[which];
  if (room.size() < n) room = Buffer<float>(n);
  kernels::keep(*this, room);
  return room.span().first(n);
}

void Backend::train_rays(const NerfField& field, const Rays& rays, const Samples& samples,
                         std::span<const float> target, const CompositeOut& out,
                         std::span<float> gradients, const RayGradients& of_rays, double* loss) {
  check_field(field, rays, samples);
  const std::size_t n = sample_count(rays.n, samples);
  const auto raw = scratch_between_stages(0, 4 * n), d_raw = scratch_between_stages(1, 4 * n),
             d_rgb = scratch_between_stages(2, 3 * static_cast<std::size_t>(rays.n));
  nerf_forward(field, rays, samples, raw);
  composite_forward(rays.n, samples, raw, {}, out);
  photometric_loss(out.rgb, target, d_rgb, loss);
  composite_backward(rays.n, samples, raw, {}, {d_rgb, {}}, d_raw);
  nerf_backward(field, rays, samples, d_raw, gradients, of_rays);
}

void Backend::render_rays(const NerfField& field, const Rays& rays, const Samples& samples,
                          const CompositeOut& out) {
  check_field(field, rays, samples);
  const auto raw = scratch_between_stages(0, 4 * sample_count(rays.n, samples));
  nerf_forward(field, rays, samples, raw);
  composite_forward(rays.n, samples, raw, {}, out);
}

}  // namespace redrive::kernels
