// SPDX-License-Identifier: Apache-2.0
// The loss of a rendered part of a LiDAR scan.
#pragma once

#include <span>
#include <vector>

#include "redrive/kernels/gaussian/gaussian_stages.h"

namespace redrive {

/// Weights of the means over the rays.
struct ScanWeights {
  float range = 0.1f;       ///< RasterImage::range_error of rays with a return
  float returns = 0.02f;    ///< squared error of the probability of a return
  float intensity = 0.01f;  ///< squared error of the intensity of rays with a return
};

/// Planes of what was measured; a place without a ray has `weight` 0.
struct ScanTarget {
  std::vector<float> log_range;  ///< kernels::kNoRange: nothing came back
  std::vector<float> intensity;  ///< 0..1
  std::vector<float> weight;     ///< 1 over the number of rays
};

/// Derivatives, as kernels::RasterGradient.
struct ScanGradient {
  std::vector<float> d_rgb, d_transmittance, d_range;
};

/// Returns the weighted loss of an image over a background of 0 and writes its derivatives. The
/// intensity's error is sum_i w_i (intensity_i - measured): transparent rays count less.
double scan_loss(const kernels::RasterImage& image, const ScanTarget& target,
                 const ScanWeights& weights, ScanGradient* gradient);

}  // namespace redrive
