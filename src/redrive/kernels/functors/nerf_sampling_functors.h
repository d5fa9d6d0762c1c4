// SPDX-License-Identifier: Apache-2.0
// The sampling of nerf_stages.h as functors for one ray in float. The host runs them in loops
// (host_stage.h), a device in kernels (device/stage.h). Their spans are in the memory where they
// run.
#pragma once

#include "redrive/base/host_device.h"
#include "redrive/kernels/nerf_stages.h"
#include "redrive/volume/hierarchical_sampling.h"

namespace redrive::kernels {

struct StratifiedRays {
  StratifiedSampling how;
  std::span<float> t, dt;

  REDRIVE_HD void operator()(std::size_t ray) const {
    const std::size_t first = ray * how.per_ray;
    stratified_ray(how.per_ray, how.near_m, how.far_m, how.jitter, how.key, first, &t[first],
                   &dt[first]);
  }
};

struct HierarchicalRays {
  Samples coarse;
  std::span<const float> weights;
  int extra;
  bool jitter;
  std::uint64_t key;
  std::span<float> t, dt;

  REDRIVE_HD void operator()(std::size_t ray) const {
    const std::size_t from = ray * coarse.per_ray, to = ray * (coarse.per_ray + extra);
    hierarchical_ray(&coarse.t[from], &weights[from], coarse.per_ray, extra, jitter, key,
                     ray * extra, &t[to], &dt[to]);
  }
};

}  // namespace redrive::kernels
