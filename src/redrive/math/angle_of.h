// SPDX-License-Identifier: Apache-2.0
// atan2 as a polynomial, for arithmetics (math/lanes.h) that have none of their own or, as GLSL,
// none that is accurate.
#pragma once

#include "redrive/math/lanes.h"

namespace redrive {

/// Angle of (x, y) from the x axis for y >= 0, in [0, pi], with an absolute error below 3e-7 for
/// vectors of floats longer than 1e-18: t P(t^2) for t in [0, 1], the ratio of the shorter to the
/// longer side, P through arctan at the Chebyshev nodes (error 1e-8, below the floats' rounding).
template <class M>
REDRIVE_LANES typename M::Real angle_of(typename M::Real y, typename M::Real x) {
  using Real = typename M::Real;
  const Real zero = M::constant(0), across = M::max(x, zero - x);
  const auto steep = y > across;
  const Real t = M::select(steep, across, y) / M::select(steep, y, across), u = t * t;
  Real p = M::constant(2.76628350e-3f);
  p = p * u + M::constant(-1.57312491e-2f);
  p = p * u + M::constant(4.21376236e-2f);
  p = p * u + M::constant(-7.45685483e-2f);
  p = p * u + M::constant(1.06183706e-1f);
  p = p * u + M::constant(-1.41977978e-1f);
  p = p * u + M::constant(1.99918720e-1f);
  p = p * u + M::constant(-3.33330367e-1f);
  p = p * u + M::constant(0.999999982f);
  const Real within = p * t, upper = M::select(steep, M::constant(1.57079633f) - within, within);
  return M::select(x < zero, M::constant(3.14159265f) - upper, upper);
}

}  // namespace redrive
