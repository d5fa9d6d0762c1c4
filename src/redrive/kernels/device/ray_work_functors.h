// SPDX-License-Identifier: Apache-2.0
// The stages of grid_stages.h that treat whole rays: what is done for one of them, or for one of
// its numbers. Spans lie on the device.
#pragma once

#include "redrive/kernels/ray_work.h"

namespace redrive::kernels {

struct IsActiveRay {
  RayCompaction how;
  int per_ray;
  std::span<const float> weights;

  REDRIVE_HD bool operator()(std::size_t ray) const {
    return is_active(how, &weights[ray * per_ray], per_ray, ray);
  }
};

struct SetToRayZero {
  std::span<std::uint32_t> rays;

  REDRIVE_HD void operator()(std::size_t) const { rays[0] = 0; }
};

/// Number i of those that `rays` have, among all n rays' numbers.
struct GatherOffset {
  std::span<const std::uint32_t> rays;
  bool in_rows;
  std::size_t each, n;

  REDRIVE_HD std::size_t operator()(std::size_t i) const {
    return in_rows ? rays[i / each] * each + i % each : i / rays.size() * n + rays[i % rays.size()];
  }
};

struct GatherRayValues {
  GatherOffset place;
  std::span<const float> from;
  std::span<float> to;

  REDRIVE_HD void operator()(std::size_t i) const { to[i] = from[place(i)]; }
};

struct CopyOrZero {
  std::span<const float> from;  ///< empty: zeros
  std::span<float> to;

  REDRIVE_HD void operator()(std::size_t i) const { to[i] = from.empty() ? 0.0f : from[i]; }
};

struct ScatterRayValues {
  GatherOffset place;
  std::span<const float> from;
  std::span<float> to;

  REDRIVE_HD void operator()(std::size_t i) const { to[place(i)] = from[i]; }
};

struct IntervalMidpoints {
  Intervals intervals;
  std::span<float> t, dt;

  REDRIVE_HD void operator()(std::size_t ray) const { midpoints_of_ray(intervals, ray, t, dt); }
};

struct EncodeDirections {
  Rays rays;
  std::span<float> harmonics;

  REDRIVE_HD void operator()(std::size_t ray) const { harmonics_of_ray(rays, ray, harmonics); }
};

struct SkyPoints {
  Rays rays;
  std::span<const float> pixel_angle;
  std::span<float> position, footprint;

  REDRIVE_HD void operator()(std::size_t ray) const {
    sky_point_of_ray(rays, pixel_angle, ray, position, footprint);
  }
};

struct SkyColours {
  HashGridConfig config;
  std::size_t n;
  std::span<const float> features;
  std::span<float> colour;

  REDRIVE_HD void operator()(std::size_t ray) const {
    sky_colour_of_ray(config, n, features, ray, colour);
  }
};

struct SkyColoursBackward {
  HashGridConfig config;
  std::size_t n;
  std::span<const float> colour, opacity, d_rgb;
  std::span<float> d_features;

  REDRIVE_HD void operator()(std::size_t ray) const {
    sky_colour_of_ray_backward(config, n, colour, opacity, d_rgb, ray, d_features);
  }
};

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
    apply_exposure_to_ray(appearance, exposure, ray, gains, rgb);
  }
};

/// Returns the ray's loss.
struct HuberLoss {
  ColourLossInput colours;
  std::span<float> d_rgb, squares;

  REDRIVE_HD double operator()(std::size_t ray) const {
    return huber_loss_of_ray(colours, ray, d_rgb, squares);
  }
};

constexpr std::size_t kRayParts =
    64;  // with some hundred knots and more, threads enough for a device

/// What rays part, part + kRayParts, ... say of one knot of one camera: partial [parts,
/// parameters]. Knots look for their rays, so that sums have an order.
struct ExposureKnotBackward {
  ColourLossInput colours;
  std::span<const float> d_rgb;
  std::span<float> partial;

  struct AddToKnot {
    std::size_t first;  ///< of its three numbers
    float* sum;

    REDRIVE_HD void operator()(std::size_t at, float derivative) const {
      if (at >= first && at < first + 3) sum[at - first] += derivative;
    }
  };
  REDRIVE_HD void operator()(std::size_t i) const {
    const AppearanceConfig& config = colours.appearance.config;
    const std::size_t knots = config.size() / 3, knot = i % knots;
    const int camera = static_cast<int>(knot / config.knots);
    float sum[3]{};
    for (std::size_t ray = i / knots; ray < colours.exposure.size(); ray += kRayParts)
      if (colours.exposure[ray].camera == camera)
        gains_of_ray_backward(colours, ray, d_rgb, AddToKnot{3 * knot, sum});
    for (int k = 0; k < 3; ++k) partial[3 * i + k] = sum[k];
  }
};

struct ScaleByGains {
  std::span<const float> gains;
  std::span<float> d_rgb;

  REDRIVE_HD void operator()(std::size_t at) const { d_rgb[at] *= gains[at]; }
};

/// Returns the parameter's loss.
struct GainRegularizer {
  Appearance appearance;
  std::span<float> d_appearance;

  REDRIVE_HD double operator()(std::size_t i) const {
    const GainRegulariser<float> term =
        gain_regulariser(appearance.config, appearance.parameters[i]);
    d_appearance[i] += term.derivative;
    return term.value;
  }
};

struct MedianDepths {
  Intervals intervals;
  std::span<const float> weights, opacity;
  std::span<float> depth;

  REDRIVE_HD void operator()(std::size_t ray) const {
    depth[ray] = median_depth_of_ray(intervals, weights, opacity, ray);
  }
};

}  // namespace redrive::kernels
