// SPDX-License-Identifier: Apache-2.0
// What is timed: a small drive of formulas, and the buffers of one batch.
#pragma once

#include <vector>

#include "redrive/rays/ray_table.h"
#include "redrive/scene/image_set.h"
#include "redrive/scene/scene.h"
#include "redrive/train/model.h"

namespace redrive::bench {

constexpr int kBatchRays = 1024;  ///< the report's

/// Four views of one 1280 x 704 pinhole, half a metre apart, near 1 m and far 10 m; images of smooth stripes.
struct SyntheticDrive {
  Scene scene;
  std::vector<Image8> images;
};
SyntheticDrive make_drive();

/// Everything a kernel of one batch reads or writes, filled with numbers like a real step's.
struct KernelBatch {
  TrainState state;
  RayBatch rays;
  std::vector<float> t, dt, raw, d_raw, rgb, depth, opacity, weights, d_rgb, gradients;

  KernelBatch(const SyntheticDrive& drive, const NerfConfig& config, int samples);
  kernels::Rays ray_spans() const { return {rays.n, rays.origin, rays.direction}; }
  kernels::Samples sample_spans() const { return {state.model.samples, t, dt}; }
  kernels::StratifiedSampling sampling() const;
};

}  // namespace redrive::bench
