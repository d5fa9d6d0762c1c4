// SPDX-License-Identifier: Apache-2.0
// Benchmarks of method nerf (model/benchmark.h).
#include <algorithm>

#include "redrive/base/rng.h"
#include "redrive/methods/nerf/nerf_model.h"
#include "redrive/volume/hierarchical_sampling.h"

namespace redrive::bench {
namespace {

// Arithmetic of the scalar formulas, per sample (Adam: per parameter), counted from the named
// files.
constexpr double kStratifiedFlops =
    4;  // volume/hierarchical_sampling.h: two for t, one for u, one for dt
constexpr double kCompositeFlops = 24;  // volume/composite.h: alpha 3, w 1, three colours of 6, T 2
constexpr double kCompositeBackwardFlops =
    44;                            // volume/composite.h: T and w 6, three colours of 12, sigma 2
constexpr double kAdamFlops = 14;  // optim/adam.h: m 3, v 4, parameter 7
constexpr double kIntervalBytes = 2 * kNumber;  // t and dt

/// Inputs and outputs of the stages for one batch, filled with values like a real step's.
struct NerfBatch {
  NerfModel model;
  AdamState adam;
  RayBatch rays;
  Buffer<float> t, dt, raw, d_raw, rgb, depth, opacity, d_rgb, gradients;

  NerfBatch(const SyntheticDrive& drive, const NerfConfig& config, int samples);
  kernels::Rays ray_spans() const { return {rays.n, rays.origin, rays.direction}; }
  kernels::Samples sample_spans() const { return {model.samples, t, dt}; }
  kernels::StratifiedSampling sampling() const;
};

NerfBatch::NerfBatch(const SyntheticDrive& drive, const NerfConfig& config, int samples) {
  model.config = config;
  model.samples = samples;
  model.configure(drive.scene);
  model.initialize(1);
  adam = model.zero_moments();
  PixelSampler(drive.scene, drive.images, 1).gather(0, 1024, &rays);
  const std::size_t n = static_cast<std::size_t>(rays.n) * samples;
  t = Buffer<float>(n);
  dt = Buffer<float>(n);
  for (int ray = 0; ray < rays.n; ++ray) {
    const auto how = sampling();
    const std::size_t first = static_cast<std::size_t>(ray) * samples;
    stratified_ray(samples, how.near_m, how.far_m, how.jitter, how.key, first, &t[first],
                   &dt[first]);
  }
  // Linear outputs of order 1, half of the densities active; gradients of a mean over the batch.
  const auto fill = [](Buffer<float>* values, std::size_t size, float scale) {
    *values = Buffer<float>(size);
    for (std::size_t i = 0; i < size; ++i)
      (*values)[i] = scale * (random_unit(random_key(1, kStreamTest), i) - 0.5f);
  };
  fill(&raw, 4 * n, 4);
  fill(&d_rgb, 3 * rays.n, 1.0f / rays.n);
  fill(&d_raw, 4 * n, 1.0f / n);
  fill(&gradients, model.parameters.size(), 1e-3f);
  rgb = Buffer<float>(3 * rays.n);
  depth = Buffer<float>(rays.n);
  opacity = Buffer<float>(rays.n);
}

kernels::StratifiedSampling NerfBatch::sampling() const {
  return {model.samples, model.near_m, model.far_m, true, random_key(1, kStreamSamples)};
}

void time_nerf_stages(kernels::Backend& backend, const SyntheticDrive& drive, Timer* timer) {
  const NerfConfig config;
  NerfBatch b(drive, config, 96);
  const double samples = static_cast<double>(b.t.size()),
               forward_flops = 2 * nerf_macs_per_sample(config);
  const double per_ray = b.model.samples,
               parameters = static_cast<double>(b.gradients.size()) / samples;
  // The last sample has no dt.
  const double field_bytes = kRayBytes / per_ray + kNumber + kRawBytes + kNumber * parameters;
  const auto field = b.model.field(0);
  timer->time("kernel/sample_stratified", samples, {kStratifiedFlops, kIntervalBytes},
              [&] { backend.nerf().sample_stratified(b.rays.n, b.sampling(), b.t, b.dt); });
  timer->time("kernel/nerf_forward-256", samples, {forward_flops, field_bytes}, [&] {
    backend.nerf().network_forward(field, b.ray_spans(), b.sample_spans(), b.raw);
  });
  // Includes recomputing the forward pass.
  timer->time("kernel/nerf_backward-256", samples,
              {3 * forward_flops, field_bytes + kGradientBytes * parameters}, [&] {
                backend.nerf().network_backward(field, b.ray_spans(), b.sample_spans(), b.d_raw,
                                                b.gradients, {});
              });
  timer->time("kernel/composite_forward", samples,
              {kCompositeFlops, kIntervalBytes + kRawBytes + kRenderedRayBytes / per_ray}, [&] {
                backend.composite_forward(b.rays.n, b.sample_spans(), b.raw, {},
                                          {b.rgb, b.depth, b.opacity, {}});
              });
  // Reads densities and colours, writes their derivatives.
  timer->time(
      "kernel/composite_backward", samples,
      {kCompositeBackwardFlops, kIntervalBytes + 2 * kRawBytes + kColourBytes / per_ray}, [&] {
        backend.composite_backward(b.rays.n, b.sample_spans(), b.raw, {}, {b.d_rgb, {}}, b.d_raw);
      });
  timer->time("kernel/adam", static_cast<double>(b.gradients.size()), {kAdamFlops, kAdamBytes},
              [&] {
                backend.adam(adam_step(5e-4, 1), b.gradients, b.model.parameters,
                             b.adam.first_moment, b.adam.second_moment);
              });
}

}  // namespace
}  // namespace redrive::bench

namespace redrive {

bench::MethodBenchmarks nerf_benchmarks() {
  const double wide = nerf_macs_per_sample({256}), narrow = nerf_macs_per_sample({128});
  return {{{256, 96, wide}, {128, 48, narrow, /*renders=*/false}}, bench::time_nerf_stages};
}

}  // namespace redrive
