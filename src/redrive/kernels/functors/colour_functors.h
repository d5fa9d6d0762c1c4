// SPDX-License-Identifier: Apache-2.0
// Stages of grid_stages.h on the colours of rays (directions, sky, exposure, Huber loss) as
// functors for one ray or one number; see functors/interval_functors.h.
#pragma once

#include <array>

#include "redrive/field/sky.h"
#include "redrive/field/spherical_harmonics.h"
#include "redrive/kernels/grid_stages.h"
#include "redrive/optim/photometric_loss.h"

namespace redrive::kernels {

struct EncodeDirections {
  Rays rays;
  std::span<float> harmonics;

  REDRIVE_HD void operator()(std::size_t ray) const {
    const std::size_t n = rays.n;
    const float direction[3] = {rays.direction[ray], rays.direction[n + ray],
                                rays.direction[2 * n + ray]};
    spherical_harmonics(direction, &harmonics[ray * kHarmonics]);
  }
};

struct SkyPoints {
  Rays rays;
  std::span<const float> pixel_angle;
  std::span<float> position, footprint;

  REDRIVE_HD void operator()(std::size_t ray) const {
    for (std::size_t at = ray; at < position.size(); at += rays.n)
      position[at] = sky_coordinate(rays.direction[at]);
    footprint[ray] = sky_footprint(pixel_angle[ray]);
  }
};

/// features [levels, n, features of a level].
struct SkyColours {
  HashGridConfig config;
  std::size_t n;
  std::span<const float> features;
  std::span<float> colour;

  REDRIVE_HD void operator()(std::size_t ray) const {
    for (int k = 0; k < 3; ++k)
      colour[k * n + ray] = sky_colour(&features[ray * config.features_per_level + k],
                                       config.n_levels, n * config.features_per_level);
  }
};

struct SkyColoursBackward {
  HashGridConfig config;
  std::size_t n;
  std::span<const float> colour, opacity, d_rgb;
  std::span<float> d_features;

  REDRIVE_HD void operator()(std::size_t ray) const {
    for (int k = 0; k < config.features_per_level; ++k) {
      const std::size_t at = k * n + ray;
      const float d = k < 3 ? sky_colour_adjoint(colour[at], (1 - opacity[ray]) * d_rgb[at]) : 0.0f;
      for (int l = 0; l < config.n_levels; ++l)
        d_features[(l * n + ray) * config.features_per_level + k] = d;
    }
  }
};

/// Writes one coordinate of a direction's derivative.
struct SkyDirectionsBackward {
  std::span<const float> d_position;
  std::span<float> d_direction;

  REDRIVE_HD void operator()(std::size_t at) const {
    d_direction[at] += sky_coordinate_adjoint(d_position[at]);
  }
};

struct ApplyExposure {
  Appearance appearance;
  std::span<const Exposure> exposure;
  std::span<float> gains, rgb;

  REDRIVE_HD void operator()(std::size_t ray) const {
    const auto of_ray =
        colour_gains(appearance.config, appearance.parameters.data(), exposure[ray]);
    for (int k = 0; k < 3; ++k) {
      const std::size_t at = k * exposure.size() + ray;
      gains[at] = of_ray[k];
      rgb[at] *= of_ray[k];
    }
  }
};

/// Returns the ray's loss, the sum over its channels.
struct HuberLoss {
  ColourLossInput colours;
  std::span<float> d_rgb, squares;

  REDRIVE_HD double operator()(std::size_t ray) const {
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
};

/// Calls add(offset in the parameters, derivative) for the derivatives of one ray's loss with
/// respect to its camera's gains. d_rgb: as HuberLoss wrote it.
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

/// Turns one number of d_rgb into the derivative before exposure.
struct ScaleByGains {
  std::span<const float> gains;
  std::span<float> d_rgb;

  REDRIVE_HD void operator()(std::size_t at) const { d_rgb[at] *= gains[at]; }
};

/// Returns the regulariser of one parameter of the gains and adds its derivative.
struct GainRegulariserLoss {
  Appearance appearance;
  std::span<float> d_appearance;

  REDRIVE_HD double operator()(std::size_t i) const {
    const GainRegulariser<float> term =
        gain_regulariser(appearance.config, appearance.parameters[i]);
    d_appearance[i] += term.derivative;
    return term.value;
  }
};

}  // namespace redrive::kernels
