// SPDX-License-Identifier: Apache-2.0
// The input of the benchmarks: a small synthetic drive, and the buffers of one batch.
#pragma once

#include <vector>

#include "redrive/base/buffer.h"
#include "redrive/image/image.h"
#include "redrive/kernels/grid/grid_stages.h"
#include "redrive/kernels/nerf/nerf_stages.h"
#include "redrive/methods/grid/grid_model.h"
#include "redrive/methods/nerf/nerf_model.h"
#include "redrive/methods/splat/splat_model.h"
#include "redrive/rays/ray_table.h"
#include "redrive/scene/scene.h"
#include "redrive/train/run.h"

namespace redrive::bench {

constexpr int kBatchRays = 1024;

/// Four views of one 1280 x 704 pinhole, half a metre apart, near 1 m and far 10 m; images of
/// smooth stripes.
struct SyntheticDrive {
  Scene scene;
  std::vector<Image8> images;
};
SyntheticDrive make_synthetic_drive();

/// Adds cars of 4 x 2 x 1.5 m that drive ahead in four lanes, 3 to 100 m before the first camera.
void add_actors(int n, SyntheticDrive* drive);

/// Returns the options of a fresh run of the method with this width and samples per ray.
TrainOptions options_of(const std::string& method, int width, int samples);

/// Inputs and outputs of the kernels for one batch of --method nerf, filled with values like a real
/// step's.
struct KernelBatch {
  TrainState state;
  RayBatch rays;
  Buffer<float> t, dt, raw, d_raw, rgb, depth, opacity, d_rgb, gradients;

  KernelBatch(const SyntheticDrive& drive, const NerfConfig& config, int samples);
  kernels::Rays ray_spans() const { return {rays.n, rays.origin, rays.direction}; }
  const NerfModel& model() const { return static_cast<const NerfModel&>(*state.model); }
  kernels::Samples sample_spans() const { return {model().samples, t, dt}; }
  kernels::StratifiedSampling sampling() const;
};

/// Inputs and outputs of the stages of --method grid: rays of the drive, with samples over all
/// distances.
struct GridBatch {
  static constexpr int per_ray = 24;
  TrainState state;
  RayBatch rays;
  Buffer<float> edges, position, footprint, features, d_features, harmonics, raw, d_table,
      d_weights;
  kernels::UnitPoints points;

  GridBatch(kernels::Backend& backend, const SyntheticDrive& drive);
  const GridModel& model() const { return static_cast<const GridModel&>(*state.model); }
  kernels::HashGrid grid() const { return model().grid(GridModel::kFieldGrid); }
  kernels::GridNetwork network() const { return model().network(); }
};

/// A run of --method splat with `n` Gaussians along a street before the drive's cameras: flat on a
/// road and two facades, as large as half the distance of their neighbours. A quarter of them
/// belong to the drive's actors, if any.
TrainState make_splat_state(const SyntheticDrive& drive, int n);

}  // namespace redrive::bench
