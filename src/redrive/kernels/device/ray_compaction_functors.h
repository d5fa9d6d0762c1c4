// SPDX-License-Identifier: Apache-2.0
// Stages of grid_stages.h that a device runs with one thread per number, and the host in loops of
// its own: gather_rays, scatter_rays and the gradients of exposure.
#pragma once

#include "redrive/kernels/functors/colour_functors.h"

namespace redrive::kernels {

/// Offset of number i of the listed rays among the numbers of all n rays.
struct GatherOffset {
  std::span<const std::uint32_t> rays;
  bool in_rows;
  std::size_t each, n;

  REDRIVE_HD std::size_t operator()(std::size_t i) const {
    return in_rows ? rays[i / each] * each + i % each : i / rays.size() * n + rays[i % rays.size()];
  }
};

struct GatherRayValues {
  GatherOffset offset;
  std::span<const float> from;
  std::span<float> to;

  REDRIVE_HD void operator()(std::size_t i) const { to[i] = from[offset(i)]; }
};

struct CopyOrZero {
  std::span<const float> from;  ///< empty for zeros
  std::span<float> to;

  REDRIVE_HD void operator()(std::size_t i) const { to[i] = from.empty() ? 0.0f : from[i]; }
};

struct ScatterRayValues {
  GatherOffset offset;
  std::span<const float> from;
  std::span<float> to;

  REDRIVE_HD void operator()(std::size_t i) const { to[offset(i)] = from[i]; }
};

constexpr std::size_t kRayParts = 64;  // occupies a device from some hundred knots on

/// Sums the derivatives of rays part, part + kRayParts, ... with respect to one knot of one camera:
/// partial [parts, parameters]. Each knot searches its rays, so that the sums have a fixed order.
struct ExposureKnotBackward {
  ColourLossInput colours;
  std::span<const float> d_rgb;
  std::span<float> partial;

  struct AddToKnot {
    std::size_t first;  ///< offset of its three numbers
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

}  // namespace redrive::kernels
