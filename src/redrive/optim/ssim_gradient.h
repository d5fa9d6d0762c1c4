// SPDX-License-Identifier: Apache-2.0
// SSIM of one window (optim/ssim.h) with its derivatives by the window's moments, templated on the
// arithmetic M (math/lanes.h). With window weights k, the derivative of sum_p SSIM(p) by pixel q of
// the first image is sum_p k(p - q) (by_x(p) + 2 x(q) by_xx(p) + y(q) by_xy(p)).
#pragma once

#include "redrive/math/lanes.h"

namespace redrive {

template <class M>
struct SsimGradient {
  typename M::Real ssim, by_x, by_xx, by_xy;
};

/// x, y, xx, yy, xy: weighted means over the window (SsimMoments).
template <class M>
REDRIVE_LANES SsimGradient<M> ssim_gradient(typename M::Real x, typename M::Real y,
                                            typename M::Real xx, typename M::Real yy,
                                            typename M::Real xy) {
  using Real = typename M::Real;
  const Real c1 = M::constant(0.01 * 0.01), c2 = M::constant(0.03 * 0.03), one = M::constant(1),
             two = M::constant(2);
  const Real means = two * x * y + c1, covariance = two * (xy - x * y) + c2;
  const Real by_means = one / (x * x + y * y + c1),
             by_variances = one / (xx - x * x + (yy - y * y) + c2);
  SsimGradient<M> out;
  out.ssim = means * covariance * by_means * by_variances;
  out.by_xx = -out.ssim * by_variances;
  out.by_xy = two * means * by_means * by_variances;
  out.by_x = two * y * covariance * by_means * by_variances - two * x * out.ssim * by_means -
             two * x * out.by_xx - y * out.by_xy;
  return out;
}

}  // namespace redrive
