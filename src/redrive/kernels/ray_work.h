// SPDX-License-Identifier: Apache-2.0
// The stages of grid_stages.h that treat whole rays: what all backends check of their sizes, and
// what they do for one ray by the scalar functions, the host in loops (host_ray_stages.h), devices
// in kernels (kernels/device/device_ray_stages.h).
#pragma once

#include "redrive/base/rng.h"
#include "redrive/field/sky.h"
#include "redrive/kernels/check_grid_sizes.h"
#include "redrive/optim/photometric_loss.h"
#include "redrive/volume/median_distance.h"

namespace redrive::kernels {

inline void check_compact_rays(int n_rays, int per_ray, std::size_t weights, std::size_t live) {
  REDRIVE_CHECK_OP(n_rays, >=, 1);
  REDRIVE_CHECK_OP(per_ray, >=, 1);
  REDRIVE_CHECK_OP(weights, ==, interval_count(n_rays, per_ray));
  REDRIVE_CHECK_OP(live, ==, static_cast<std::size_t>(n_rays));
}

REDRIVE_HD inline bool is_active(const RayCompaction& how, const float* weights, int per_ray,
                                 std::size_t ray) {
  float opacity = 0;
  for (int i = 0; i < per_ray; ++i) opacity += weights[i];
  // Not "below": what is not a number goes on into the loss.
  return !(opacity < how.min_opacity) || random_unit(how.key, ray) < how.keep_probability;
}

/// Returns the numbers of a ray: `few` are those of `rays`, `all` those of all.
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

REDRIVE_HD inline void midpoints_of_ray(const Intervals& intervals, std::size_t ray,
                                        std::span<float> t, std::span<float> dt) {
  const std::size_t first = ray * intervals.per_ray;
  const float* const edges = &intervals.edges[first + ray];
  for (int s = 0; s < intervals.per_ray; ++s) {
    t[first + s] = 0.5f * (edges[s] + edges[s + 1]);
    dt[first + s] = edges[s + 1] - edges[s];
  }
}

inline void check_directions(const Rays& rays) {
  REDRIVE_CHECK_OP(rays.n, >=, 1);
  REDRIVE_CHECK_OP(rays.direction.size(), ==, 3 * static_cast<std::size_t>(rays.n));
}

inline void check_harmonics(const Rays& rays, std::size_t harmonics) {
  check_directions(rays);
  REDRIVE_CHECK_OP(harmonics, ==, static_cast<std::size_t>(rays.n) * kHarmonics);
}

REDRIVE_HD inline void harmonics_of_ray(const Rays& rays, std::size_t ray,
                                        std::span<float> harmonics) {
  const std::size_t n = rays.n;
  const float direction[3] = {rays.direction[ray], rays.direction[n + ray],
                              rays.direction[2 * n + ray]};
  spherical_harmonics(direction, &harmonics[ray * kHarmonics]);
}

inline void check_sky(const HashGrid& grid, const Rays& rays, std::size_t pixel_angle,
                      std::size_t colour) {
  check_directions(rays);
  REDRIVE_CHECK_OP(grid.config.features, >=, 3);
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

REDRIVE_HD inline void sky_point_of_ray(const Rays& rays, std::span<const float> pixel_angle,
                                        std::size_t ray, std::span<float> position,
                                        std::span<float> footprint) {
  for (std::size_t at = ray; at < position.size(); at += rays.n)
    position[at] = sky_coordinate(rays.direction[at]);
  footprint[ray] = sky_footprint(pixel_angle[ray]);
}

/// features [levels, n, features of a level].
REDRIVE_HD inline void sky_colour_of_ray(const HashGridConfig& config, std::size_t n,
                                         std::span<const float> features, std::size_t ray,
                                         std::span<float> colour) {
  for (int k = 0; k < 3; ++k)
    colour[k * n + ray] =
        sky_colour(&features[ray * config.features + k], config.levels, n * config.features);
}

REDRIVE_HD inline void sky_colour_of_ray_backward(const HashGridConfig& config, std::size_t n,
                                                  std::span<const float> colour,
                                                  std::span<const float> opacity,
                                                  std::span<const float> d_rgb, std::size_t ray,
                                                  std::span<float> d_features) {
  for (int k = 0; k < config.features; ++k) {
    const std::size_t at = k * n + ray;
    const float d = k < 3 ? sky_colour_adjoint(colour[at], (1 - opacity[ray]) * d_rgb[at]) : 0.0f;
    for (int l = 0; l < config.levels; ++l) d_features[(l * n + ray) * config.features + k] = d;
  }
}

inline void check_apply_exposure(const Appearance& appearance, std::size_t exposure,
                                 std::size_t gains, std::size_t rgb) {
  REDRIVE_CHECK_OP(exposure, >, 0u);
  REDRIVE_CHECK_OP(appearance.parameters.size(), ==, appearance.config.size());
  REDRIVE_CHECK_OP(gains, ==, 3 * exposure);
  REDRIVE_CHECK_OP(rgb, ==, gains);
}

REDRIVE_HD inline void apply_exposure_to_ray(const Appearance& appearance,
                                             std::span<const Exposure> exposure, std::size_t ray,
                                             std::span<float> gains, std::span<float> rgb) {
  const auto of_ray = colour_gains(appearance.config, appearance.parameters.data(), exposure[ray]);
  for (int k = 0; k < 3; ++k) {
    const std::size_t at = k * exposure.size() + ray;
    gains[at] = of_ray[k];
    rgb[at] *= of_ray[k];
  }
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

/// The first half of `huber_loss`: returns the ray's loss, the sum over its channels.
REDRIVE_HD inline float huber_loss_of_ray(const ColourLossInput& colours, std::size_t ray,
                                          std::span<float> d_rgb, std::span<float> squares) {
  const std::size_t n = squares.size();
  float square = 0;
  for (std::size_t at = ray; at < 3 * n; at += n) {
    const float error = colours.rgb[at] - colours.target[at];
    square += error * error;
  }
  squares[ray] = square / 3;
  const HuberTerm<float> huber = huber_term(square, colours.huber_delta);
  const float weight = colours.weight.empty() ? 1.0f : colours.weight[ray];
  for (std::size_t at = ray; at < 3 * n; at += n) d_rgb[at] *= weight * huber.factor;
  return weight * huber.value;
}

/// Its second half, for the gains: d_rgb as huber_loss_of_ray left it. Calls add(number of the
/// appearance's parameters, its derivative).
template <class Add>
REDRIVE_HD void gains_of_ray_backward(const ColourLossInput& colours, std::size_t ray,
                                      std::span<const float> d_rgb, const Add& add) {
  std::array<float, 3> gains, d_gains;
  for (int k = 0; k < 3; ++k) {
    const std::size_t at = k * colours.exposure.size() + ray;
    gains[k] = colours.gains[at];
    d_gains[k] = d_rgb[at] * colours.rgb[at] / colours.gains[at];
  }
  colour_gains_adjoint(colours.appearance.config, colours.exposure[ray], gains, d_gains, add);
}

inline void check_median_depth(int n_rays, const Intervals& intervals, std::size_t weights,
                               std::size_t opacity, std::size_t depth) {
  check_intervals(n_rays, intervals, weights);
  REDRIVE_CHECK_OP(opacity, ==, static_cast<std::size_t>(n_rays));
  REDRIVE_CHECK_OP(depth, ==, opacity);
}

REDRIVE_HD inline float median_depth_of_ray(const Intervals& intervals,
                                            std::span<const float> weights,
                                            std::span<const float> opacity, std::size_t ray) {
  const std::size_t first = ray * intervals.per_ray;
  return median_distance(&intervals.edges[first + ray], &weights[first], intervals.per_ray,
                         opacity[ray]);
}

}  // namespace redrive::kernels
