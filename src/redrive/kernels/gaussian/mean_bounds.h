// SPDX-License-Identifier: Apache-2.0
// Where the means of the Gaussians of a raster with PixelCentres may lie.
#pragma once

#include <limits>

#include "redrive/kernels/gaussian/gaussian_stages.h"

namespace redrive::kernels {

/// How far beyond the centres of pixels the mean of a Gaussian may lie, in focal lengths (rad): the
/// reach of one of 6 cm at 1 m.
constexpr float kBeyondCentres = 0.2f;

/// Returns the rectangle in which means must lie: from the pose in the middle, and from their own.
/// Cameras have no such bound but PlainCamera::max_radius2.
inline RasterBounds mean_bounds(const GaussianCamera& camera, const RasterBounds& pixels) {
  if (camera.centres.u.empty()) {
    constexpr float kFar = std::numeric_limits<float>::infinity();
    return {-kFar, kFar, -kFar, kFar};
  }
  const float u = kBeyondCentres * camera.camera.fx, v = kBeyondCentres * camera.camera.fy;
  return {pixels.left - u, pixels.right + u, pixels.top - v, pixels.bottom + v};
}

}  // namespace redrive::kernels
