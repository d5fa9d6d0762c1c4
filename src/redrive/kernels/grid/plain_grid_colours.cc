// SPDX-License-Identifier: Apache-2.0
// The stages of PlainGridStages on the colours of rays: directions, sky, exposure, Huber loss.
#include <array>

#include "redrive/field/sky.h"
#include "redrive/field/spherical_harmonics.h"
#include "redrive/kernels/grid/check_grid_sizes.h"
#include "redrive/kernels/grid/check_ray_sizes.h"
#include "redrive/kernels/grid/plain_grid_stages.h"
#include "redrive/optim/photometric_loss.h"

namespace redrive::kernels {

void PlainGridStages::harmonics(const Rays& rays, std::span<float> harmonics) {
  check_harmonics(rays, harmonics.size());
  const std::size_t n = rays.n;
  loop_.for_each(n, [&](std::size_t ray) {
    const float direction[3] = {rays.direction[ray], rays.direction[n + ray],
                                rays.direction[2 * n + ray]};
    spherical_harmonics(direction, &harmonics[ray * kHarmonics]);
  });
}

std::span<float> PlainGridStages::first(Buffer<float>* buffer, std::size_t n) {
  if (buffer->size() < n) *buffer = Buffer<float>(n);
  return buffer->span().first(n);
}

UnitPoints PlainGridStages::sky_points(const Rays& rays, std::span<const float> pixel_angle) {
  const std::size_t n = rays.n;
  const auto position = first(&position_, 3 * n), footprint = first(&footprint_, n);
  loop_.for_each(n, [&](std::size_t ray) {
    for (std::size_t at = ray; at < 3 * n; at += n)
      position[at] = sky_coordinate(rays.direction[at]);
    footprint[ray] = sky_footprint(pixel_angle[ray]);
  });
  return {n, position, footprint};
}

void PlainGridStages::sky(const HashGrid& grid, const Rays& rays,
                          std::span<const float> pixel_angle, std::span<float> colour) {
  check_sky(grid, rays, pixel_angle.size(), colour.size());
  const UnitPoints points = sky_points(rays, pixel_angle);
  const auto features = first(&features_, points.n * grid.config.outputs());
  encode(grid, points, features);
  const int each = grid.config.features_per_level;
  loop_.for_each(points.n, [&](std::size_t ray) {
    for (int k = 0; k < 3; ++k)
      colour[k * points.n + ray] =
          sky_colour(&features[ray * each + k], grid.config.n_levels, points.n * each);
  });
}

void PlainGridStages::sky_backward(const HashGrid& grid, const Rays& rays,
                                   std::span<const float> pixel_angle,
                                   std::span<const float> colour, std::span<const float> opacity,
                                   std::span<const float> d_rgb, std::span<float> d_table,
                                   std::span<float> d_direction) {
  check_sky_backward(grid, rays, pixel_angle.size(), colour.size(), opacity.size(), d_rgb.size(),
                     d_table.size(), d_direction.size());
  const UnitPoints points = sky_points(rays, pixel_angle);
  const auto d_features = first(&features_, points.n * grid.config.outputs()),
             d_position = first(&d_position_, d_direction.size());
  loop_.for_each(points.n, [&](std::size_t ray) {
    for (int k = 0; k < grid.config.features_per_level; ++k) {
      const std::size_t at = k * points.n + ray;
      const float d = k < 3 ? sky_colour_adjoint(colour[at], (1 - opacity[ray]) * d_rgb[at]) : 0.0f;
      for (int l = 0; l < grid.config.n_levels; ++l)
        d_features[(l * points.n + ray) * grid.config.features_per_level + k] = d;
    }
  });
  encode_backward(grid, points, d_features, d_table, d_position);
  loop_.for_each(d_direction.size(), [&](std::size_t at) {
    d_direction[at] += sky_coordinate_adjoint(d_position[at]);
  });
}

void PlainGridStages::apply_exposure(const Appearance& appearance,
                                     std::span<const Exposure> exposure, std::span<float> gains,
                                     std::span<float> rgb) {
  check_apply_exposure(appearance, exposure.size(), gains.size(), rgb.size());
  loop_.for_each(exposure.size(), [&](std::size_t ray) {
    const auto of_ray =
        colour_gains(appearance.config, appearance.parameters.data(), exposure[ray]);
    for (int k = 0; k < 3; ++k) {
      const std::size_t at = k * exposure.size() + ray;
      gains[at] = of_ray[k];
      rgb[at] *= of_ray[k];
    }
  });
}

void PlainGridStages::huber_loss(const ColourLossInput& colours, std::span<float> d_rgb,
                                 std::span<float> squares, std::span<float> d_appearance,
                                 double* loss) {
  check_huber_loss(colours, d_rgb.size(), squares.size(), d_appearance.size());
  const std::size_t n = squares.size();
  const double sum = loop_.sum(n, [&](std::size_t ray) -> double {
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
  });
  *loss = sum / (3.0 * static_cast<double>(n));
  if (!colours.exposure.empty()) *loss += gains_backward(colours, d_rgb, d_appearance);
}

double PlainGridStages::gains_backward(const ColourLossInput& colours, std::span<float> d_rgb,
                                       std::span<float> d_appearance) {
  const std::size_t n = colours.exposure.size();
  const auto add = [&](std::size_t at, float derivative) { d_appearance[at] += derivative; };
  for (std::size_t ray = 0; ray < n; ++ray) {  // in order: rays share parameters
    std::array<float, 3> gains, d_gains;
    for (int k = 0; k < 3; ++k) {
      const std::size_t at = k * n + ray;
      gains[k] = colours.gains[at];
      d_gains[k] = d_rgb[at] * colours.rgb[at] / colours.gains[at];
    }
    colour_gains_adjoint(colours.appearance.config, colours.exposure[ray], gains, d_gains, add);
  }
  // The derivatives before exposure.
  loop_.for_each(d_rgb.size(), [&](std::size_t at) { d_rgb[at] *= colours.gains[at]; });
  return loop_.sum(d_appearance.size(), [&](std::size_t i) -> double {
    const GainRegulariser<float> term =
        gain_regulariser(colours.appearance.config, colours.appearance.parameters[i]);
    d_appearance[i] += term.derivative;
    return term.value;
  });
}

}  // namespace redrive::kernels
