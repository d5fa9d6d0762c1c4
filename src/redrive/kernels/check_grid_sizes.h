// SPDX-License-Identifier: Apache-2.0
// The size checks that every backend makes at the head of the stages of grid_stages.h, and what they have in common of a ray.
#pragma once

#include "redrive/base/error.h"
#include "redrive/kernels/kernels.h"

namespace redrive::kernels {

inline std::size_t interval_count(int n_rays, int per_ray) {
  return static_cast<std::size_t>(n_rays) * static_cast<std::size_t>(per_ray);
}

inline void check_edges(int n_rays, int per_ray, std::size_t edges) {
  REDRIVE_CHECK_OP(n_rays, >=, 1);
  REDRIVE_CHECK_OP(per_ray, >=, 1);
  REDRIVE_CHECK_OP(edges, ==, interval_count(n_rays, per_ray + 1));
}

inline void check_spaced(const Rays& rays, int per_ray, std::size_t edges) {
  check_edges(rays.n, per_ray, edges);
  REDRIVE_CHECK_OP(rays.origin.size(), ==, 3 * static_cast<std::size_t>(rays.n));
  REDRIVE_CHECK_OP(rays.direction.size(), ==, 3 * static_cast<std::size_t>(rays.n));
}

/// Stage `spaced` of one ray.
inline void spaced_edges_of(const Rays& rays, const SpacedIntervals& how, std::size_t ray, std::span<float> edges) {
  float origin[3], direction[3];
  for (int k = 0; k < 3; ++k) {
    origin[k] = rays.origin[k * rays.n + ray];
    direction[k] = rays.direction[k * rays.n + ray];
  }
  spaced_edges(spacing_of_ray(how.spacing, how.contraction, origin, direction), how.per_ray, how.jitter, how.key, ray,
               &edges[ray * (how.per_ray + 1)]);
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

inline void check_network(const GridNetwork& network, int n_rays, int per_ray, std::size_t features,
                          std::size_t harmonics, std::size_t raw) {
  const std::size_t n = interval_count(n_rays, per_ray);
  REDRIVE_CHECK_OP(network.config.grid.features, >=, 2);
  REDRIVE_CHECK_OP(network.weights.size(), ==, grid_network_size(network.config));
  REDRIVE_CHECK_OP(features, ==, n * static_cast<std::size_t>(network.config.grid.outputs()));
  REDRIVE_CHECK_OP(harmonics, ==, static_cast<std::size_t>(n_rays) * kHarmonics);
  REDRIVE_CHECK_OP(raw, ==, 4 * n);
}

inline void check_proposal(const HashGrid& grid, const UnitPoints& points, std::size_t density) {
  REDRIVE_CHECK_OP(grid.config.features, ==, 1);
  check_points(points);
  REDRIVE_CHECK_OP(grid.table.size(), ==, hash_grid_size(grid.config));
  REDRIVE_CHECK_OP(density, ==, points.n);
}

inline void check_range(int n_rays, const Intervals& intervals, std::size_t weights, std::size_t range_m,
                        float spread_m, std::size_t d_weights) {
  check_edges(n_rays, intervals.per_ray, intervals.edges.size());
  REDRIVE_CHECK_OP(weights, ==, interval_count(n_rays, intervals.per_ray));
  REDRIVE_CHECK_OP(range_m, ==, static_cast<std::size_t>(n_rays));
  REDRIVE_CHECK_OP(spread_m, >, 0);
  REDRIVE_CHECK_OP(d_weights, ==, weights);
}

}  // namespace redrive::kernels
