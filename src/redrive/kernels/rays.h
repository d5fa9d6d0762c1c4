// SPDX-License-Identifier: Apache-2.0
// Batches for the stages of backend.h, nerf_stages.h and grid_stages.h: spans and sizes, structure
// of arrays.
#pragma once

#include <cstdint>
#include <span>

namespace redrive::kernels {

/// Rays in world metres: origin [3, n], direction [3, n] (unit length).
struct Rays {
  int n = 0;
  std::span<const float> origin, direction;
  std::span<const std::int64_t> t_ns = {};  ///< [n] times; empty: nothing that moves is met
};

/// Samples along rays: distance t [n_rays, per_ray] from the origin in metres, ascending; interval
/// length dt [n_rays, per_ray] >= 0 in metres. The last dt of a ray may be +infinity
/// (volume/composite.h).
struct Samples {
  int per_ray = 0;
  std::span<const float> t, dt;
};

}  // namespace redrive::kernels
