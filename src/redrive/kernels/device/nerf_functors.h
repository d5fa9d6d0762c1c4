// SPDX-License-Identifier: Apache-2.0
// Gradients of rays (NerfStages::network_backward) as a functor for one ray. Its spans are on the
// device.
#pragma once

#include "redrive/base/host_device.h"
#include "redrive/kernels/add_ray_gradient.h"
#include "redrive/kernels/nerf_stages.h"

namespace redrive::kernels {

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
