// SPDX-License-Identifier: Apache-2.0
// Size checks at the head of the stages of grid_stages.h, the same for every backend.
#pragma once

#include <cstddef>

#include "redrive/base/error.h"
#include "redrive/kernels/grid/grid_stages.h"

namespace redrive::kernels {

inline std::size_t interval_count(int n_rays, int per_ray) {
  return static_cast<std::size_t>(n_rays) * static_cast<std::size_t>(per_ray);
}

inline void check_edges(int n_rays, int per_ray, std::size_t edges) {
  REDRIVE_CHECK_OP(n_rays, >=, 1);
  REDRIVE_CHECK_OP(per_ray, >=, 1);
  REDRIVE_CHECK_OP(edges, ==, interval_count(n_rays, per_ray + 1));
}

/// `numbers`: count of an array with one number per interval.
inline void check_intervals(int n_rays, const Intervals& intervals, std::size_t numbers) {
  check_edges(n_rays, intervals.per_ray, intervals.edges.size());
  REDRIVE_CHECK_OP(numbers, ==, interval_count(n_rays, intervals.per_ray));
}

inline void check_sample_uniform(const Rays& rays, int per_ray, std::size_t edges) {
  check_edges(rays.n, per_ray, edges);
  REDRIVE_CHECK_OP(rays.origin.size(), ==, 3 * static_cast<std::size_t>(rays.n));
  REDRIVE_CHECK_OP(rays.direction.size(), ==, 3 * static_cast<std::size_t>(rays.n));
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

inline void check_contract_backward(const Rays& rays, const Intervals& intervals,
                                    std::size_t d_position, std::size_t d_origin,
                                    std::size_t d_direction) {
  check_sample_uniform(rays, intervals.per_ray, intervals.edges.size());
  REDRIVE_CHECK_OP(d_position, ==, 3 * interval_count(rays.n, intervals.per_ray));
  REDRIVE_CHECK_OP(d_origin, ==, rays.origin.size());
  REDRIVE_CHECK_OP(d_direction, ==, rays.origin.size());
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
  REDRIVE_CHECK_OP(network.config.grid.features_per_level, >=, 2);
  REDRIVE_CHECK_OP(network.weights.size(), ==, grid_network_size(network.config));
  REDRIVE_CHECK_OP(features, ==, n * static_cast<std::size_t>(network.config.grid.outputs()));
  REDRIVE_CHECK_OP(harmonics, ==, static_cast<std::size_t>(n_rays) * kHarmonics);
  REDRIVE_CHECK_OP(raw, ==, 4 * n);
}

inline void check_network_backward(const GridNetwork& network, int n_rays, int per_ray,
                                   std::size_t features, std::size_t harmonics, std::size_t d_raw,
                                   std::size_t d_weights, std::size_t d_features) {
  check_network(network, n_rays, per_ray, features, harmonics, d_raw);
  REDRIVE_CHECK_OP(d_weights, ==, network.weights.size());
  REDRIVE_CHECK_OP(d_features, ==, features);
}

inline void check_proposal_density(const HashGrid& grid, const UnitPoints& points,
                                   std::size_t density) {
  REDRIVE_CHECK_OP(grid.config.features_per_level, ==, 1);
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
