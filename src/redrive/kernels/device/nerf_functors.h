// SPDX-License-Identifier: Apache-2.0
// Stages of nerf_stages.h except the network, as functors for one ray in float that call the scalar
// functions. Their spans are on the device.
#pragma once

#include "redrive/base/host_device.h"
#include "redrive/kernels/add_ray_gradient.h"
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

/// Adds a ray's derivatives from d_position [3, n] of its samples.
struct AddRayGradients {
  UnitFromWorld unit_from_world;
  int n_rays;
  Samples samples;
  std::span<const float> d_position;
  RayGradients of_rays;

  REDRIVE_HD void operator()(std::size_t ray) const {
    const std::size_t per_ray = samples.per_ray;
    add_ray_gradient(unit_from_world, n_rays, samples, static_cast<int>(ray),
                     &d_position[ray * per_ray], n_rays * per_ray, of_rays);
  }
};

}  // namespace redrive::kernels
