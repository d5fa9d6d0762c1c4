// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/nerf/cpu/front_to_back.h"

#include <algorithm>
#include <cmath>

#include "redrive/field/activation.h"
#include "redrive/kernels/cpu/ray_points.h"

namespace redrive::kernels {
namespace {

/// sum of sigma_i dt_i: -log of the transmittance of `count` intervals (volume/composite.h). NaN
/// stays NaN.
double optical_depth(const float* density, const float* dt, int count) {
  double sum = 0;
  for (int i = 0; i < count; ++i) {
    const double sigma = relu(density[i]);
    if (sigma != 0) sum += sigma * dt[i];
  }
  return sum;
}

}  // namespace

// Blocks of 16,384 samples: 256 KB of raw stay in the second-level cache, and the last, partly
// filled tile of a stride is one of ten or more.
FrontToBack::FrontToBack(int per_ray, int tile_samples)
    : per_ray_(per_ray),
      tile_samples_(tile_samples),
      block_rays_(std::max(1, 16384 / per_ray)),
      optical_depth_(block_rays_),
      raw_(4 * static_cast<std::size_t>(block_rays_) * per_ray),
      tile_raw_(4 * static_cast<std::size_t>(tile_samples)),
      position_(3 * static_cast<std::size_t>(tile_samples)),
      direction_(3 * static_cast<std::size_t>(tile_samples)) {}

const float* FrontToBack::run(NerfChunk& chunk, const NerfField& field, const Rays& rays,
                              const Samples& samples, RayRange block) {
  const double opaque_depth = -std::log(kMinTransmittance);
  open_.resize(block.n);
  for (int ray = 0; ray < block.n; ++ray) open_[ray] = ray;
  std::fill_n(optical_depth_.begin(), block.n, 0.0);

  for (int from = 0; from < per_ray_ && !open_.empty(); from += kStride) {
    const int count = std::min({kStride, per_ray_ - from, tile_samples_});
    const std::size_t tile_rays = tile_samples_ / count;
    std::size_t still_open = 0;
    for (std::size_t first = 0; first < open_.size(); first += tile_rays) {
      const int n = static_cast<int>(std::min(tile_rays, open_.size() - first)), stride = n * count;
      for (int i = 0; i < n; ++i) {
        const std::size_t ray = block.first + open_[first + i];
        compute_points({.n_rays = 1,
                        .per_ray = count,
                        .origin = rays.origin.data() + ray,
                        .direction = rays.direction.data() + ray,
                        .ray_stride = static_cast<std::size_t>(rays.n),
                        .t = samples.t.data() + ray * per_ray_ + from,
                        .center = field.unit_from_world.center.data(),
                        .scale = field.unit_from_world.scale,
                        .position = position_.data() + i * count,
                        .stride = static_cast<std::size_t>(stride)});
        for (int d = 0; d < 3; ++d)
          direction_[d * n + i] = rays.direction[static_cast<std::size_t>(d) * rays.n + ray];
      }
      chunk.forward({.n_rays = n,
                     .per_ray = count,
                     .position = position_.data(),
                     .direction = direction_.data()},
                    false, tile_raw_.data(), stride);
      for (int i = 0; i < n; ++i) {
        const int ray = open_[first + i];
        float* raw = raw_.data() + static_cast<std::size_t>(ray) * per_ray_ + from;
        for (int k = 0; k < 4; ++k)
          std::copy_n(tile_raw_.data() + k * stride + i * count, count, raw + k * raw_stride());
        const float* dt =
            samples.dt.data() + static_cast<std::size_t>(block.first + ray) * per_ray_ + from;
        optical_depth_[ray] += optical_depth(raw + 3 * raw_stride(), dt, count);
        if (optical_depth_[ray] > opaque_depth) {
          const int skipped = per_ray_ - from - count;
          for (int k = 0; k < 4; ++k)
            std::fill_n(raw + k * raw_stride() + count, skipped, k < 3 ? 0.0f : -1.0f);
        } else {
          open_[still_open++] = ray;
        }
      }
    }
    open_.resize(still_open);
  }
  return raw_.data();
}

}  // namespace redrive::kernels
