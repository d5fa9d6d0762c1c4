// SPDX-License-Identifier: Apache-2.0
// Positions of samples along rays in the cube of the NeRF field.
#pragma once

#include <cstddef>

namespace redrive::kernels {

/// Rays, and where compute_points writes position[d * stride + ray * per_ray + s] = (origin + t
/// direction - center) * scale.
struct RayPoints {
  int n_rays = 0, per_ray = 0;
  const float *origin = nullptr,
              *direction = nullptr;  ///< coordinate d of a ray at [d * ray_stride + ray]
  std::size_t ray_stride = 0;
  const float* t = nullptr;
  const float* center = nullptr;
  float scale = 1;
  float* position = nullptr;
  std::size_t stride = 0;
};

inline void compute_points(const RayPoints& rays) {
  for (int ray = 0; ray < rays.n_rays; ++ray) {
    const std::size_t first = static_cast<std::size_t>(ray) * rays.per_ray;
    for (int d = 0; d < 3; ++d) {
      const float origin = rays.origin[d * rays.ray_stride + ray] - rays.center[d];
      const float direction = rays.direction[d * rays.ray_stride + ray], scale = rays.scale;
      const float* __restrict t = rays.t + first;
      float* __restrict out = rays.position + d * rays.stride + first;
      for (int i = 0; i < rays.per_ray; ++i) out[i] = (origin + t[i] * direction) * scale;
    }
  }
}

}  // namespace redrive::kernels
