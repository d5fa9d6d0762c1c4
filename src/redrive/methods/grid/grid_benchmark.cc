// SPDX-License-Identifier: Apache-2.0
// Benchmarks of method grid (model/benchmark.h).
#include <algorithm>

#include "redrive/base/rng.h"
#include "redrive/methods/grid/grid_model.h"

namespace redrive::bench {
namespace {

constexpr double kPointBytes = 4 * kNumber;  // in the unit cube: position and footprint

/// Inputs and outputs of the stages: rays of the drive, with samples over all distances.
struct GridBatch {
  static constexpr int per_ray = 24;
  GridModel model;
  RayBatch rays;
  Buffer<float> edges, position, footprint, features, d_features, harmonics, raw, d_table,
      d_weights;
  kernels::UnitPoints points;

  GridBatch(kernels::Backend& backend, const SyntheticDrive& drive);
  kernels::HashGrid grid() const { return model.grid(GridModel::kFieldGrid); }
  kernels::GridNetwork network() const { return model.network(); }
};

GridBatch::GridBatch(kernels::Backend& backend, const SyntheticDrive& drive) {
  model.samples = per_ray;
  model.configure(drive.scene);
  model.initialize(1);
  constexpr int kRays = 2048;
  PixelSampler(drive.scene, drive.images, 1).gather(0, kRays, &rays);
  const std::size_t n = static_cast<std::size_t>(rays.n) * per_ray;
  edges = Buffer<float>(n + rays.n);
  position = Buffer<float>(3 * n);
  footprint = Buffer<float>(n);
  features = Buffer<float>(n * model.field.grid.outputs());
  d_features = Buffer<float>(features.size());
  harmonics = Buffer<float>(static_cast<std::size_t>(rays.n) * kHarmonics);
  std::ranges::fill(harmonics.span(), 0.3f);
  raw = Buffer<float>(4 * n);
  std::ranges::fill(raw.span(), 1e-3f);
  d_table = Buffer<float>(grid().table.size());
  d_weights = Buffer<float>(network().weights.size());
  kernels::GridStages& stages = backend.grid();
  stages.sample_uniform(
      rays_of(rays),
      {per_ray, model.spacing, model.contraction, true, random_key(1, kStreamSamples)}, edges);
  stages.contract(model.contraction, rays_of(rays), rays.pixel_angle, {per_ray, edges}, 0, position,
                  footprint);
  points = {n, position, footprint};
  stages.encode(grid(), points, features);
}

void time_grid_stages(kernels::Backend& backend, const SyntheticDrive& drive, Timer* timer) {
  GridBatch b(backend, drive);
  kernels::GridStages& stages = backend.grid();
  const int n = b.rays.n;
  const double samples = static_cast<double>(b.points.n), levels = b.model.field.grid.n_levels,
               features = b.model.field.grid.features_per_level,
               macs = grid_macs_per_sample(b.model.field);
  // Per level: three coordinates of 3, eight weights of 2, eight rows of 2 operations a feature.
  // The adjoint takes twice as many.
  const double encode_flops = levels * (25 + 16 * features);
  // Eight rows per level, at most the level's rows per batch, which samples share.
  const double rows_bytes = std::min(levels * 8 * features * kNumber,
                                     kNumber * static_cast<double>(b.d_table.size()) / samples);
  const double features_bytes = levels * features * kNumber;
  const double weights = static_cast<double>(b.d_weights.size()) / samples;
  const double network_bytes =
      features_bytes + kHarmonics * kNumber / GridBatch::per_ray + kRawBytes + kNumber * weights;
  timer->time("kernel/grid_encode", samples,
              {encode_flops, kPointBytes + features_bytes + rows_bytes},
              [&] { stages.encode(b.grid(), b.points, b.features); });
  timer->time(
      "kernel/grid_encode_backward", samples,
      {2 * encode_flops, kPointBytes + features_bytes + 2 * rows_bytes},  // rows are added to
      [&] { stages.encode_backward(b.grid(), b.points, b.features, b.d_table, {}); });
  timer->time("kernel/grid_network_forward", samples, {2 * macs, network_bytes}, [&] {
    stages.network_forward(b.network(), n, b.per_ray, b.features, b.harmonics, b.raw);
  });
  // Includes recomputing the forward pass.
  timer->time("kernel/grid_network_backward", samples,
              {6 * macs, network_bytes + features_bytes + kGradientBytes * weights}, [&] {
                stages.network_backward(b.network(), n, b.per_ray, b.features, b.harmonics, b.raw,
                                        b.d_weights, b.d_features);
              });
}

}  // namespace
}  // namespace redrive::bench

namespace redrive {

bench::MethodBenchmarks grid_benchmarks() {
  return {{{32, bench::GridBatch::per_ray, grid_macs_per_sample(GridModel{}.field)}},
          bench::time_grid_stages};
}

}  // namespace redrive
