// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/host_grid_stages.h"

#include <algorithm>

namespace redrive::kernels {
namespace {

/// Calls visit(offset in the gathered array, offset in the whole array, length) for each run of
/// numbers.
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

void add_gain_gradients(HostStage& /*stage*/, const ColourLossInput& colours,
                        std::span<const float> d_rgb, std::span<float> d_appearance) {
  for (std::size_t ray = 0; ray < colours.exposure.size(); ++ray)
    gains_of_ray_backward(colours, ray, d_rgb, [&](std::size_t at, float derivative) {
      d_appearance[at] += derivative;
    });
}

template class CommonGridStages<HostExecutor>;

void HostGridStages::gather_rays(std::span<const std::uint32_t> rays, RayLayout layout,
                                 std::span<const float> from, std::span<float> to) {
  const std::size_t each = check_gather_rays(rays.size(), to.size(), from.size());
  for_each_run(rays, layout, each, from.size(),
               [&](std::size_t here, std::size_t there, std::size_t numbers) {
                 std::copy_n(&from[there], numbers, &to[here]);
               });
}

void HostGridStages::scatter_rays(std::span<const std::uint32_t> rays, RayLayout layout,
                                  std::span<const float> from, std::span<const float> otherwise,
                                  std::span<float> to) {
  const std::size_t each =
      check_scatter_rays(rays.size(), from.size(), otherwise.size(), to.size());
  if (otherwise.empty())
    std::ranges::fill(to, 0.0f);
  else
    std::ranges::copy(otherwise, to.begin());
  for_each_run(rays, layout, each, to.size(),
               [&](std::size_t here, std::size_t there, std::size_t numbers) {
                 std::copy_n(&from[here], numbers, &to[there]);
               });
}

std::span<float> HostGridStages::first(Buffer<float>* buffer, std::size_t n) {
  if (buffer->size() < n) *buffer = Buffer<float>(n);
  return buffer->span().first(n);
}

UnitPoints HostGridStages::sky_points(const Rays& rays, std::span<const float> pixel_angle) {
  const std::size_t n = rays.n;
  const auto position = first(&position_, 3 * n), footprint = first(&footprint_, n);
  executor_.stage().for_each(n, SkyPoints{rays, pixel_angle, position, footprint});
  return {n, position, footprint};
}

void HostGridStages::sky(const HashGrid& grid, const Rays& rays, std::span<const float> pixel_angle,
                         std::span<float> colour) {
  check_sky(grid, rays, pixel_angle.size(), colour.size());
  const UnitPoints points = sky_points(rays, pixel_angle);
  const auto features = first(&features_, points.n * grid.config.outputs());
  encode(grid, points, features);
  executor_.stage().for_each(points.n, SkyColours{grid.config, points.n, features, colour});
}

void HostGridStages::sky_backward(const HashGrid& grid, const Rays& rays,
                                  std::span<const float> pixel_angle, std::span<const float> colour,
                                  std::span<const float> opacity, std::span<const float> d_rgb,
                                  std::span<float> d_table, std::span<float> d_direction) {
  check_sky_backward(grid, rays, pixel_angle.size(), colour.size(), opacity.size(), d_rgb.size(),
                     d_table.size(), d_direction.size());
  const UnitPoints points = sky_points(rays, pixel_angle);
  const auto d_features = first(&features_, points.n * grid.config.outputs()),
             d_position = first(&d_position_, d_direction.size());
  executor_.stage().for_each(
      points.n, SkyColoursBackward{grid.config, points.n, colour, opacity, d_rgb, d_features});
  encode_backward(grid, points, d_features, d_table, d_position);
  executor_.stage().for_each(d_direction.size(), SkyDirectionsBackward{d_position, d_direction});
}

}  // namespace redrive::kernels
