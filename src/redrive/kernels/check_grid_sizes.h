// SPDX-License-Identifier: Apache-2.0
// The size checks that every backend makes at the head of the stages of grid_stages.h, and what
// they have in common of a ray.
#pragma once

#include <cmath>

#include "redrive/base/error.h"
#include "redrive/kernels/grid_stages.h"

namespace redrive::kernels {

inline std::size_t interval_count(int n_rays, int per_ray) {
  return static_cast<std::size_t>(n_rays) * static_cast<std::size_t>(per_ray);
}

inline void check_edges(int n_rays, int per_ray, std::size_t edges) {
  REDRIVE_CHECK_OP(n_rays, >=, 1);
  REDRIVE_CHECK_OP(per_ray, >=, 1);
  REDRIVE_CHECK_OP(edges, ==, interval_count(n_rays, per_ray + 1));
}

/// `numbers`: one for each interval.
inline void check_intervals(int n_rays, const Intervals& intervals, std::size_t numbers) {
  check_edges(n_rays, intervals.per_ray, intervals.edges.size());
  REDRIVE_CHECK_OP(numbers, ==, interval_count(n_rays, intervals.per_ray));
}

inline void check_sample_uniform(const Rays& rays, int per_ray, std::size_t edges) {
  check_edges(rays.n, per_ray, edges);
  REDRIVE_CHECK_OP(rays.origin.size(), ==, 3 * static_cast<std::size_t>(rays.n));
  REDRIVE_CHECK_OP(rays.direction.size(), ==, 3 * static_cast<std::size_t>(rays.n));
}

/// Stage `spaced` of one ray.
REDRIVE_HD inline void uniform_edges_of_ray(const Rays& rays, const UniformSampling& how,
                                            std::size_t ray, std::span<float> edges) {
  float origin[3], direction[3];
  for (int k = 0; k < 3; ++k) {
    origin[k] = rays.origin[k * rays.n + ray];
    direction[k] = rays.direction[k * rays.n + ray];
  }
  uniform_edges(clip_to_scene(how.spacing, how.contraction, origin, direction), how.per_ray,
                how.jitter, how.key, ray, &edges[ray * (how.per_ray + 1)]);
}

inline void check_sample_pdf(int n_rays, const Intervals& from, std::size_t weights, int per_ray,
                             std::size_t edges) {
  check_intervals(n_rays, from, weights);
  check_edges(n_rays, per_ray, edges);
}

inline void check_contract(const Rays& rays, const Intervals& intervals, std::size_t pixel_angle,
                           std::size_t position, std::size_t footprint) {
  check_sample_uniform(rays, intervals.per_ray, intervals.edges.size());
  const std::size_t n = interval_count(rays.n, intervals.per_ray);
  REDRIVE_CHECK_OP(pixel_angle, ==, static_cast<std::size_t>(rays.n));
  REDRIVE_CHECK_OP(position, ==, 3 * n);
  REDRIVE_CHECK_OP(footprint, ==, n);
}

/// Stage `contract` of sample `s` of one ray, in double.
REDRIVE_HD inline void contract_sample(const Contraction& contraction, const Rays& rays,
                                       std::span<const float> pixel_angle,
                                       const Intervals& intervals, float least_width,
                                       std::size_t ray, std::size_t s, std::span<float> position,
                                       std::span<float> footprint) {
  const std::size_t n_rays = rays.n, n = n_rays * intervals.per_ray,
                    i = ray * intervals.per_ray + s, edge = i + ray;
  const double begin = intervals.edges[edge], end = intervals.edges[edge + 1],
               t = 0.5 * (begin + end);
  double world[3], unit[3];
  for (int k = 0; k < 3; ++k)
    world[k] = rays.origin[k * n_rays + ray] + t * rays.direction[k * n_rays + ray];
  const double factor = contract(contraction, world, unit), side = pixel_angle[ray] * t;
  for (int k = 0; k < 3; ++k) position[k * n + i] = static_cast<float>(unit[k]);
  const double volume = side * side * (end - begin), least = least_width * (end - begin);
  footprint[i] = static_cast<float>(factor * std::fmax(std::cbrt(volume), least));
}

inline void check_contract_backward(const Rays& rays, const Intervals& intervals,
                                    std::size_t d_position, std::size_t d_origin,
                                    std::size_t d_direction) {
  check_sample_uniform(rays, intervals.per_ray, intervals.edges.size());
  REDRIVE_CHECK_OP(d_position, ==, 3 * interval_count(rays.n, intervals.per_ray));
  REDRIVE_CHECK_OP(d_origin, ==, rays.origin.size());
  REDRIVE_CHECK_OP(d_direction, ==, rays.origin.size());
}

/// Stage `contract_backward` of one ray, in T.
template <class T>
REDRIVE_HD void contract_ray_backward(const Contraction& contraction, const Rays& rays,
                                      const Intervals& intervals, std::span<const float> d_position,
                                      std::size_t ray, std::span<float> d_origin,
                                      std::span<float> d_direction) {
  const std::size_t n_rays = rays.n, n = n_rays * intervals.per_ray;
  T origin[3]{}, direction[3]{};
  for (int s = 0; s < intervals.per_ray; ++s) {
    const std::size_t i = ray * intervals.per_ray + s, edge = i + ray;
    const T t = T(0.5) * (T(intervals.edges[edge]) + T(intervals.edges[edge + 1]));
    T world[3], d_unit[3], d_world[3];
    for (int k = 0; k < 3; ++k) {
      world[k] = T(rays.origin[k * n_rays + ray]) + t * T(rays.direction[k * n_rays + ray]);
      d_unit[k] = T(d_position[k * n + i]);
    }
    contract_adjoint(contraction, world, d_unit, d_world);
    for (int k = 0; k < 3; ++k) {
      origin[k] += d_world[k];
      direction[k] += t * d_world[k];
    }
  }
  for (int k = 0; k < 3; ++k) {
    d_origin[k * n_rays + ray] = static_cast<float>(origin[k]);
    d_direction[k * n_rays + ray] = static_cast<float>(direction[k]);
  }
}

inline void check_points(const UnitPoints& points) {
  REDRIVE_CHECK_OP(points.position.size(), ==, 3 * (points.stride > 0 ? points.stride : points.n));
  REDRIVE_CHECK(points.stride == 0 || points.stride >= points.n);
  REDRIVE_CHECK_OP(points.footprint.size(), ==, points.n);
}

inline void check_encode(const HashGrid& grid, const UnitPoints& points, std::size_t features) {
  check_points(points);
  REDRIVE_CHECK_OP(grid.table.size(), ==, hash_grid_size(grid.config));
  REDRIVE_CHECK_OP(features, ==, points.n * static_cast<std::size_t>(grid.config.outputs()));
}

inline void check_encode_backward(const HashGrid& grid, const UnitPoints& points,
                                  std::size_t d_features, std::size_t d_table,
                                  std::size_t d_position) {
  check_encode(grid, points, d_features);
  REDRIVE_CHECK_OP(d_table, ==, grid.table.size());
  if (d_position > 0) REDRIVE_CHECK_OP(d_position, ==, 3 * points.n);
}

inline void check_network(const GridNetwork& network, int n_rays, int per_ray, std::size_t features,
                          std::size_t harmonics, std::size_t raw) {
  const std::size_t n = interval_count(n_rays, per_ray);
  REDRIVE_CHECK_OP(network.config.grid.features, >=, 2);
  REDRIVE_CHECK_OP(network.weights.size(), ==, grid_network_size(network.config));
  REDRIVE_CHECK_OP(features, ==, n * static_cast<std::size_t>(network.config.grid.outputs()));
  REDRIVE_CHECK_OP(harmonics, ==, static_cast<std::size_t>(n_rays) * kHarmonics);
  REDRIVE_CHECK_OP(raw, ==, 4 * n);
}

inline void check_proposal_density(const HashGrid& grid, const UnitPoints& points,
                                   std::size_t density) {
  REDRIVE_CHECK_OP(grid.config.features, ==, 1);
  check_points(points);
  REDRIVE_CHECK_OP(grid.table.size(), ==, hash_grid_size(grid.config));
  REDRIVE_CHECK_OP(density, ==, points.n);
}

inline void check_proposal_density_backward(const HashGrid& grid, const UnitPoints& points,
                                            std::size_t density, std::size_t d_density,
                                            std::size_t d_table) {
  check_proposal_density(grid, points, density);
  REDRIVE_CHECK_OP(d_density, ==, points.n);
  REDRIVE_CHECK_OP(d_table, ==, grid.table.size());
}

inline void check_weights(int n_rays, const Intervals& intervals, std::size_t density,
                          std::size_t weights) {
  check_intervals(n_rays, intervals, density);
  REDRIVE_CHECK_OP(weights, ==, density);
}

inline void check_weights_backward(int n_rays, const Intervals& intervals, std::size_t density,
                                   std::size_t weights, std::size_t d_weights,
                                   std::size_t d_density) {
  check_weights(n_rays, intervals, density, weights);
  REDRIVE_CHECK_OP(d_weights, ==, density);
  REDRIVE_CHECK_OP(d_density, ==, density);
}

inline void check_proposal(int n_rays, const Intervals& intervals, std::size_t weights,
                           const Intervals& proposal, std::size_t proposal_weights,
                           std::size_t d_proposal) {
  check_intervals(n_rays, intervals, weights);
  check_intervals(n_rays, proposal, proposal_weights);
  REDRIVE_CHECK_OP(d_proposal, ==, proposal_weights);
}

inline void check_range(int n_rays, const Intervals& intervals, std::size_t weights,
                        std::size_t range_m, float spread_m, std::size_t d_weights) {
  check_intervals(n_rays, intervals, weights);
  REDRIVE_CHECK_OP(range_m, ==, static_cast<std::size_t>(n_rays));
  REDRIVE_CHECK_OP(spread_m, >, 0);
  REDRIVE_CHECK_OP(d_weights, ==, weights);
}

inline void check_sparsity(int n_rays, const Intervals& intervals, std::size_t density,
                           std::size_t d_density) {
  check_intervals(n_rays, intervals, density);
  REDRIVE_CHECK_OP(d_density, ==, density);
}

}  // namespace redrive::kernels
