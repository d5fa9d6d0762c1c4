// SPDX-License-Identifier: Apache-2.0
// Derivatives of the loss with respect to a ray's origin and direction, from its samples'
// derivatives.
#pragma once

#include "redrive/kernels/nerf/nerf_stages.h"

namespace redrive::kernels {

/// Adds one ray's derivatives: d_origin += scale sum d_x_s, d_direction += scale sum t_s d_x_s,
/// from the derivatives of its samples' positions in the unit cube x_s = (origin + t_s direction -
/// center) scale. Coordinate k of d_x_s is d_position[k * stride + s]. Sums in double, in order.
template <class T>
void add_ray_gradient(const UnitFromWorld& unit_from_world, int n_rays, const Samples& samples,
                      int ray, const T* d_position, std::size_t stride,
                      const RayGradients& of_rays) {
  const float* t = &samples.t[static_cast<std::size_t>(ray) * samples.per_ray];
  for (int k = 0; k < 3; ++k) {
    double d_origin = 0, d_direction = 0;
    for (int s = 0; s < samples.per_ray; ++s) {
      const double d = d_position[k * stride + s];
      d_origin += d;
      d_direction += t[s] * d;
    }
    const std::size_t at = k * static_cast<std::size_t>(n_rays) + ray;
    of_rays.d_origin[at] += static_cast<float>(unit_from_world.scale * d_origin);
    of_rays.d_direction[at] += static_cast<float>(unit_from_world.scale * d_direction);
  }
}

}  // namespace redrive::kernels
