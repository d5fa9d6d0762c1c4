// SPDX-License-Identifier: Apache-2.0
// The spherical projection, in which the beams of a LiDAR are rasterised (Hess et al., SplatAD,
// CVPR 2025, arXiv 2411.16816), for numbers and vectors (math/lanes.h):
//   (X, Y, Z) -> x = atan2(X, Z), y = atan2(Y, sqrt(X^2 + Z^2)), radians:
// the azimuth to the right of the axis Z, in (-pi, pi], and the angle below the plane of X and Z.
// It is one-to-one but for the poles, X = Z = 0. No camera has it: images are recorded on planes.
#pragma once

#include "redrive/camera/lenses/lens.h"

namespace redrive {

struct SphericalPlane {
  template <class M>
  static REDRIVE_LANES PlanePoint<M> project(typename M::Real x, typename M::Real y,
                                             typename M::Real z) {
    using Real = typename M::Real;
    const Real zero = M::constant(0), across = M::sqrt(x * x + z * z);
    PlanePoint<M> p;
    p.x = signed_as<M>(x, M::atan2(M::max(x, zero - x), z));
    p.y = signed_as<M>(y, M::atan2(M::max(y, zero - y), across));
    p.s = p.x * p.x + p.y * p.y;
    p.seen = across > zero;
    return p;
  }
  /// Adds the derivatives of x d_x + y d_y by the point.
  template <class M>
  static REDRIVE_LANES void adjoint(typename M::Real x, typename M::Real y, typename M::Real z,
                                    typename M::Real d_x, typename M::Real d_y,
                                    typename M::Real* d_point) {
    using Real = typename M::Real;
    const Real one = M::constant(1), square = x * x + z * z, across = M::sqrt(square),
               by_azimuth = d_x / square, by_height = d_y / (square + y * y),
               by_across = by_height * y * (one / across);
    d_point[0] = d_point[0] + by_azimuth * z - by_across * x;
    d_point[1] = d_point[1] + by_height * across;
    d_point[2] = d_point[2] - by_azimuth * x - by_across * z;
  }

 private:
  /// Returns `size` >= 0 with the sign of `of`.
  template <class M>
  static REDRIVE_LANES typename M::Real signed_as(typename M::Real of, typename M::Real size) {
    const typename M::Real zero = M::constant(0);
    return M::select(of < zero, zero - size, size);
  }
};

}  // namespace redrive
