// SPDX-License-Identifier: Apache-2.0
// Size checks at the head of those stages of grid_stages.h that work on whole rays.
#pragma once

#include "redrive/kernels/grid/check_grid_sizes.h"

namespace redrive::kernels {

inline void check_compact_rays(int n_rays, int per_ray, std::size_t weights, std::size_t live) {
  REDRIVE_CHECK_OP(n_rays, >=, 1);
  REDRIVE_CHECK_OP(per_ray, >=, 1);
  REDRIVE_CHECK_OP(weights, ==, interval_count(n_rays, per_ray));
  REDRIVE_CHECK_OP(live, ==, static_cast<std::size_t>(n_rays));
}

/// Returns the numbers per ray. `few`: size of the array of the listed rays, `all`: size for all
/// rays.
inline std::size_t check_gather_rays(std::size_t rays, std::size_t few, std::size_t all) {
  REDRIVE_CHECK_OP(rays, >, 0u);
  REDRIVE_CHECK_OP(few, >, 0u);
  REDRIVE_CHECK_OP(few % rays, ==, 0u);
  const std::size_t each = few / rays;
  REDRIVE_CHECK_OP(all, >, 0u);
  REDRIVE_CHECK_OP(all % each, ==, 0u);
  return each;
}

inline std::size_t check_scatter_rays(std::size_t rays, std::size_t from, std::size_t elsewhere,
                                      std::size_t to) {
  if (elsewhere > 0) REDRIVE_CHECK_OP(elsewhere, ==, to);
  return check_gather_rays(rays, from, to);
}

inline void check_midpoints(int n_rays, const Intervals& intervals, std::size_t t, std::size_t dt) {
  check_intervals(n_rays, intervals, t);
  REDRIVE_CHECK_OP(dt, ==, t);
}

inline void check_directions(const Rays& rays) {
  REDRIVE_CHECK_OP(rays.n, >=, 1);
  REDRIVE_CHECK_OP(rays.direction.size(), ==, 3 * static_cast<std::size_t>(rays.n));
}

inline void check_harmonics(const Rays& rays, std::size_t harmonics) {
  check_directions(rays);
  REDRIVE_CHECK_OP(harmonics, ==, static_cast<std::size_t>(rays.n) * kHarmonics);
}

inline void check_sky(const HashGrid& grid, const Rays& rays, std::size_t pixel_angle,
                      std::size_t colour) {
  check_directions(rays);
  REDRIVE_CHECK_OP(grid.config.features_per_level, >=, 3);
  REDRIVE_CHECK_OP(grid.table.size(), ==, hash_grid_size(grid.config));
  REDRIVE_CHECK_OP(pixel_angle, ==, static_cast<std::size_t>(rays.n));
  REDRIVE_CHECK_OP(colour, ==, rays.direction.size());
}

inline void check_sky_backward(const HashGrid& grid, const Rays& rays, std::size_t pixel_angle,
                               std::size_t colour, std::size_t opacity, std::size_t d_rgb,
                               std::size_t d_table, std::size_t d_direction) {
  check_sky(grid, rays, pixel_angle, colour);
  REDRIVE_CHECK_OP(opacity, ==, pixel_angle);
  REDRIVE_CHECK_OP(d_rgb, ==, colour);
  REDRIVE_CHECK_OP(d_table, ==, grid.table.size());
  if (d_direction > 0) REDRIVE_CHECK_OP(d_direction, ==, colour);
}

inline void check_apply_exposure(const Appearance& appearance, std::size_t exposure,
                                 std::size_t gains, std::size_t rgb) {
  REDRIVE_CHECK_OP(exposure, >, 0u);
  REDRIVE_CHECK_OP(appearance.parameters.size(), ==, appearance.config.size());
  REDRIVE_CHECK_OP(gains, ==, 3 * exposure);
  REDRIVE_CHECK_OP(rgb, ==, gains);
}

inline void check_huber_loss(const ColourLossInput& colours, std::size_t d_rgb, std::size_t squares,
                             std::size_t d_appearance) {
  const std::size_t n = squares, parameters = colours.appearance.parameters.size();
  REDRIVE_CHECK_OP(n, >, 0u);
  REDRIVE_CHECK_OP(colours.rgb.size(), ==, 3 * n);
  REDRIVE_CHECK_OP(colours.target.size(), ==, 3 * n);
  REDRIVE_CHECK_OP(d_rgb, ==, 3 * n);
  if (!colours.weight.empty()) REDRIVE_CHECK_OP(colours.weight.size(), ==, n);
  REDRIVE_CHECK_OP(colours.huber_delta, >, 0);
  if (colours.exposure.empty()) return;
  REDRIVE_CHECK_OP(colours.exposure.size(), ==, n);
  REDRIVE_CHECK_OP(colours.gains.size(), ==, 3 * n);
  REDRIVE_CHECK_OP(parameters, ==, colours.appearance.config.size());
  REDRIVE_CHECK_OP(d_appearance, ==, parameters);
}

inline void check_median_depth(int n_rays, const Intervals& intervals, std::size_t weights,
                               std::size_t opacity, std::size_t depth) {
  check_intervals(n_rays, intervals, weights);
  REDRIVE_CHECK_OP(opacity, ==, static_cast<std::size_t>(n_rays));
  REDRIVE_CHECK_OP(depth, ==, opacity);
}

}  // namespace redrive::kernels
