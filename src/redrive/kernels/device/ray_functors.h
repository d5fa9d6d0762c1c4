// SPDX-License-Identifier: Apache-2.0
// Stages of backend.h except the networks, as functors for one ray or one number, in float, that
// call the scalar functions. Their spans are on the device.
#pragma once

#include <cmath>

#include "redrive/base/host_device.h"
#include "redrive/kernels/backend.h"
#include "redrive/kernels/check_sizes.h"
#include "redrive/optim/photometric_loss.h"
#include "redrive/volume/composite.h"

namespace redrive::kernels {

struct Fill {
  std::span<float> numbers;
  float value;

  REDRIVE_HD void operator()(std::size_t i) const { numbers[i] = value; }
};

/// Returns 1 for infinity and NaN, else 0.
struct IsNotFinite {
  std::span<const float> numbers;

  REDRIVE_HD double operator()(std::size_t i) const { return std::isfinite(numbers[i]) ? 0 : 1; }
};

/// The three channels of a ray in [3, n_rays].
struct ColourOfRay {
  float value[3];

  REDRIVE_HD ColourOfRay(std::span<const float> rgb, std::size_t n_rays, std::size_t ray) {
    for (int k = 0; k < 3; ++k) value[k] = rgb.empty() ? 0.0f : rgb[k * n_rays + ray];
  }
};

struct CompositeRays {
  std::size_t n_rays;
  Samples samples;
  std::span<const float> raw, background;
  CompositeOut out;

  REDRIVE_HD void operator()(std::size_t ray) const {
    const std::size_t first = ray * samples.per_ray, n = n_rays * samples.per_ray;
    const ColourOfRay behind(background, n_rays, ray);
    const RayComposite<float> sum =
        composite_ray(&raw[first], n, &samples.t[first], &samples.dt[first], samples.per_ray,
                      out.weights.empty() ? nullptr : &out.weights[first],
                      background.empty() ? nullptr : behind.value);
    for (int k = 0; k < 3; ++k) out.rgb[k * n_rays + ray] = sum.rgb[k];
    out.depth[ray] = sum.depth;
    out.opacity[ray] = sum.opacity;
  }
};

struct CompositeRaysBackward {
  std::size_t n_rays;
  Samples samples;
  std::span<const float> raw, background;
  CompositeOutGradient d_out;
  std::span<float> d_raw;

  REDRIVE_HD void operator()(std::size_t ray) const {
    const std::size_t first = ray * samples.per_ray, n = n_rays * samples.per_ray;
    const ColourOfRay d_rgb(d_out.d_rgb, n_rays, ray), behind(background, n_rays, ray);
    composite_ray_adjoint(&raw[first], n, &samples.dt[first], samples.per_ray, d_rgb.value,
                          &d_raw[first],
                          d_out.d_weights.empty() ? nullptr : &d_out.d_weights[first],
                          background.empty() ? nullptr : behind.value);
  }
};

/// Returns one channel's part of the loss.
struct PhotometricLoss {
  std::span<const float> rgb, target;
  int n_rays;
  std::span<float> d_rgb;

  REDRIVE_HD double operator()(std::size_t i) const {
    const PhotometricTerm<double> term = photometric_term<double>(rgb[i], target[i], n_rays);
    d_rgb[i] = static_cast<float>(term.derivative);
    return term.value;
  }
};

struct AdamUpdate {
  AdamStep step;
  std::span<float> gradients, parameters, first_moment, second_moment;

  REDRIVE_HD void operator()(std::size_t i) const {
    adam_update(step, gradients[i], parameters[i], first_moment[i], second_moment[i]);
    gradients[i] = 0;
  }
};

}  // namespace redrive::kernels
