// SPDX-License-Identifier: Apache-2.0
// What a tile's backward pass sums for a Gaussian, and the derivatives that follow from it, for
// numbers, vectors and shaders (math/lanes.h).
#pragma once

#include "redrive/field/gaussian.h"

namespace redrive::kernels {

/// Sums over the pixels of a tile. The first six are derivatives by log alpha, times offsets from
/// the mean.
enum PairSum {
  kSumAlpha,
  kSumX,
  kSumY,
  kSumXX,
  kSumXY,
  kSumYY,
  kSumRgb,  ///< 3: derivatives by the colour
  kSumError = 9,
  kSumLogDistance,  ///< derivative by the logarithm of the distance
  kPairSums
};

/// sum: [kPairSums], over all pairs of the Gaussian.
template <class M>
REDRIVE_LANES ProjectedGradient<M> gradient_of_sums(const typename M::Real* sum,
                                                    const ProjectedGaussian<M>& at) {
  ProjectedGradient<M> gradient;
  gradient.mean[0] = at.conic[0] * sum[kSumX] + at.conic[1] * sum[kSumY];
  gradient.mean[1] = at.conic[1] * sum[kSumX] + at.conic[2] * sum[kSumY];
  gradient.conic[0] = M::constant(-0.5) * sum[kSumXX];
  gradient.conic[1] = -sum[kSumXY];
  gradient.conic[2] = M::constant(-0.5) * sum[kSumYY];
  gradient.log_alpha = sum[kSumAlpha];
  for (int k = 0; k < 3; ++k) gradient.colour[k] = sum[kSumRgb + k];
  gradient.length = sum[kSumLogDistance] / at.length;
  return gradient;
}

}  // namespace redrive::kernels
