// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/host_ray_stages.h"

#include <algorithm>

#include "redrive/kernels/ray_work.h"

namespace redrive::kernels {
namespace {

/// visit(place of a run among those of `rays`, its place among all, its numbers).
template <class Visit>
void for_each_run(std::span<const std::uint32_t> rays, RayLayout layout, std::size_t each,
                  std::size_t all, const Visit& visit) {
  const std::size_t few = rays.size(), n = all / each;
  if (layout == RayLayout::kRows) {
    for (std::size_t i = 0; i < few; ++i) visit(i * each, rays[i] * each, each);
  } else {
    for (std::size_t k = 0; k < each; ++k)
      for (std::size_t i = 0; i < few; ++i) visit(k * few + i, k * n + rays[i], std::size_t{1});
  }
}

}  // namespace

int HostRayStages::compact_rays(int n_rays, int per_ray, std::span<const float> weights,
                                const RayCompaction& how, std::span<std::uint32_t> live) {
  check_compact_rays(n_rays, per_ray, weights.size(), live.size());
  int count = 0;
  for (int ray = 0; ray < n_rays; ++ray)
    if (is_active(how, &weights[interval_count(ray, per_ray)], per_ray, ray))
      live[count++] = static_cast<std::uint32_t>(ray);
  if (count == 0) live[count++] = 0;
  return count;
}

void HostRayStages::gather_rays(std::span<const std::uint32_t> rays, RayLayout layout,
                                std::span<const float> from, std::span<float> to) {
  const std::size_t each = check_gather_rays(rays.size(), to.size(), from.size());
  for_each_run(rays, layout, each, from.size(),
               [&](std::size_t here, std::size_t there, std::size_t numbers) {
                 std::copy_n(&from[there], numbers, &to[here]);
               });
}

void HostRayStages::scatter_rays(std::span<const std::uint32_t> rays, RayLayout layout,
                                 std::span<const float> from, std::span<const float> elsewhere,
                                 std::span<float> to) {
  const std::size_t each =
      check_scatter_rays(rays.size(), from.size(), elsewhere.size(), to.size());
  if (elsewhere.empty())
    std::ranges::fill(to, 0.0f);
  else
    std::ranges::copy(elsewhere, to.begin());
  for_each_run(rays, layout, each, to.size(),
               [&](std::size_t here, std::size_t there, std::size_t numbers) {
                 std::copy_n(&from[here], numbers, &to[there]);
               });
}

void HostRayStages::midpoints(int n_rays, const Intervals& intervals, std::span<float> t,
                              std::span<float> dt) {
  check_midpoints(n_rays, intervals, t.size(), dt.size());
  for (int ray = 0; ray < n_rays; ++ray) midpoints_of_ray(intervals, ray, t, dt);
}

void HostRayStages::harmonics(const Rays& rays, std::span<float> harmonics) {
  check_harmonics(rays, harmonics.size());
  for (int ray = 0; ray < rays.n; ++ray) harmonics_of_ray(rays, ray, harmonics);
}

std::span<float> HostRayStages::first(Buffer<float>* buffer, std::size_t n) {
  if (buffer->size() < n) *buffer = Buffer<float>(n);
  return buffer->span().first(n);
}

UnitPoints HostRayStages::sky_points(const Rays& rays, std::span<const float> pixel_angle) {
  const std::size_t n = rays.n;
  const auto position = first(&position_, 3 * n), footprint = first(&footprint_, n);
  for (std::size_t ray = 0; ray < n; ++ray)
    sky_point_of_ray(rays, pixel_angle, ray, position, footprint);
  return {n, position, footprint};
}

void HostRayStages::sky(const HashGrid& grid, const Rays& rays, std::span<const float> pixel_angle,
                        std::span<float> colour) {
  check_sky(grid, rays, pixel_angle.size(), colour.size());
  const UnitPoints points = sky_points(rays, pixel_angle);
  const auto features = first(&features_, points.n * grid.config.outputs());
  encode(grid, points, features);
  for (std::size_t ray = 0; ray < points.n; ++ray)
    sky_colour_of_ray(grid.config, points.n, features, ray, colour);
}

void HostRayStages::sky_backward(const HashGrid& grid, const Rays& rays,
                                 std::span<const float> pixel_angle, std::span<const float> colour,
                                 std::span<const float> opacity, std::span<const float> d_rgb,
                                 std::span<float> d_table, std::span<float> d_direction) {
  check_sky_backward(grid, rays, pixel_angle.size(), colour.size(), opacity.size(), d_rgb.size(),
                     d_table.size(), d_direction.size());
  const UnitPoints points = sky_points(rays, pixel_angle);
  const auto d_features = first(&features_, points.n * grid.config.outputs()),
             d_position = first(&d_position_, d_direction.size());
  for (std::size_t ray = 0; ray < points.n; ++ray)
    sky_colour_of_ray_backward(grid.config, points.n, colour, opacity, d_rgb, ray, d_features);
  encode_backward(grid, points, d_features, d_table, d_position);
  for (std::size_t at = 0; at < d_direction.size(); ++at)
    d_direction[at] += sky_coordinate_adjoint(d_position[at]);
}

void HostRayStages::apply_exposure(const Appearance& appearance, std::span<const Exposure> exposure,
                                   std::span<float> gains, std::span<float> rgb) {
  check_apply_exposure(appearance, exposure.size(), gains.size(), rgb.size());
  for (std::size_t ray = 0; ray < exposure.size(); ++ray)
    apply_exposure_to_ray(appearance, exposure, ray, gains, rgb);
}

void HostRayStages::median_depth(int n_rays, const Intervals& intervals,
                                 std::span<const float> weights, std::span<const float> opacity,
                                 std::span<float> depth) {
  check_median_depth(n_rays, intervals, weights.size(), opacity.size(), depth.size());
  for (int ray = 0; ray < n_rays; ++ray)
    depth[ray] = median_depth_of_ray(intervals, weights, opacity, ray);
}

void HostRayStages::huber_loss(const ColourLossInput& colours, std::span<float> d_rgb,
                               std::span<float> squares, std::span<float> d_appearance,
                               double* loss) {
  check_huber_loss(colours, d_rgb.size(), squares.size(), d_appearance.size());
  const std::size_t n = squares.size();
  double sum = 0;
  for (std::size_t ray = 0; ray < n; ++ray) sum += huber_loss_of_ray(colours, ray, d_rgb, squares);
  *loss = sum / (3.0 * static_cast<double>(n));
  if (colours.exposure.empty()) return;
  for (std::size_t ray = 0; ray < n; ++ray)
    gains_of_ray_backward(colours, ray, d_rgb, [&](std::size_t at, float derivative) {
      d_appearance[at] += derivative;
    });
  for (std::size_t at = 0; at < 3 * n; ++at) d_rgb[at] *= colours.gains[at];
  double of_gains = 0;
  for (std::size_t i = 0; i < d_appearance.size(); ++i) {
    const GainRegulariser<float> term =
        gain_regulariser(colours.appearance.config, colours.appearance.parameters[i]);
    of_gains += term.value;
    d_appearance[i] += term.derivative;
  }
  *loss += of_gains;
}

}  // namespace redrive::kernels
