// SPDX-License-Identifier: Apache-2.0
// Size checks at the head of the stages of nerf_stages.h, the same for every backend.
#pragma once

#include "redrive/kernels/check_sizes.h"
#include "redrive/kernels/nerf/nerf_stages.h"

namespace redrive::kernels {

inline void check_field(const NerfField& field, const Rays& rays, const Samples& samples) {
  check_samples(rays.n, samples);
  REDRIVE_CHECK_OP(rays.origin.size(), ==, 3 * static_cast<std::size_t>(rays.n));
  REDRIVE_CHECK_OP(rays.direction.size(), ==, 3 * static_cast<std::size_t>(rays.n));
  REDRIVE_CHECK_OP(field.parameters.size(), ==, nerf_parameter_count(field.config));
}

inline void check_stratified(int n_rays, const StratifiedSampling& how, std::size_t t_size,
                             std::size_t dt_size) {
  REDRIVE_CHECK_OP(n_rays, >=, 1);
  REDRIVE_CHECK_OP(how.per_ray, >=, 1);
  REDRIVE_CHECK_OP(how.near_m, <, how.far_m);
  REDRIVE_CHECK_OP(t_size, ==, static_cast<std::size_t>(n_rays) * how.per_ray);
  REDRIVE_CHECK_OP(dt_size, ==, t_size);
}

inline void check_ray_gradients(int n_rays, const RayGradients& of_rays) {
  REDRIVE_CHECK_OP(of_rays.d_direction.size(), ==, of_rays.d_origin.size());
  if (of_rays.wanted())
    REDRIVE_CHECK_OP(of_rays.d_origin.size(), ==, 3 * static_cast<std::size_t>(n_rays));
}

inline void check_field_backward(const NerfField& field, const Rays& rays, const Samples& samples,
                                 std::size_t d_raw, std::size_t gradients,
                                 const RayGradients& of_rays) {
  check_field(field, rays, samples);
  check_raw(rays.n, samples, d_raw);
  check_ray_gradients(rays.n, of_rays);
  REDRIVE_CHECK_OP(gradients, ==, field.parameters.size());
}

/// Returns the number of rays.
inline int check_hierarchical(const Samples& coarse, std::size_t weights_size, int extra,
                              std::size_t t_size, std::size_t dt_size) {
  REDRIVE_CHECK_OP(coarse.per_ray, >=, 3);
  REDRIVE_CHECK_OP(extra, >=, 1);
  const int n_rays = static_cast<int>(coarse.t.size() / coarse.per_ray);
  check_samples(n_rays, coarse);
  REDRIVE_CHECK_OP(weights_size, ==, coarse.t.size());
  REDRIVE_CHECK_OP(t_size, ==, static_cast<std::size_t>(n_rays) * (coarse.per_ray + extra));
  REDRIVE_CHECK_OP(dt_size, ==, t_size);
  return n_rays;
}

}  // namespace redrive::kernels
