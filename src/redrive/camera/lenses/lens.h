// SPDX-License-Identifier: Apache-2.0
// The projection of a camera model and its derivatives, written once for numbers, numbers with
// derivatives and vectors of numbers (math/lanes.h):
//   (X, Y, Z) -> (x, y) on a plane, s = x^2 + y^2 -> (x_d, y_d),
//   x_d = x g(s) + 2 p1 x y + p2 (s + 2 x^2) + sx1 s + sx2 s^2,
//   y_d = y g(s) + p1 (s + 2 y^2) + 2 p2 x y + sy1 s + sy2 s^2,
// and with a shear (x_d + shear_x y_d, y_d + shear_y x_d).
// A model has a Plane (the first arrow), a Radial (the factor g) and Numbers, its coefficients in
// any precision. Terms whose coefficients the Numbers lack are left out.
#pragma once

#include <array>
#include <optional>

#include "redrive/math/lanes.h"

namespace redrive {

/// A point on the plane.
template <class M>
struct PlanePoint {
  typename M::Real x, y, s;   ///< s: square of the radius
  typename M::Mask seen;      ///< whether the point has a place on the plane
  typename M::Real scale{};   ///< (x, y) = scale (X, Y)
  typename M::Real length{};  ///< length of the point, where the plane needs it
};

template <class M>
struct RadialFactor {
  typename M::Real value, slope;  ///< g and dg/ds
};

/// A distorted point, and whether the model is one-to-one there.
template <class M>
struct LensPoint {
  typename M::Real x, y;
  typename M::Mask valid;
};

/// Distorts a point of the plane. limit: value of s beyond which g is constant and nothing valid.
template <class Radial, class M, class Numbers>
REDRIVE_LANES LensPoint<M> distort(const Numbers& c, typename M::Real limit,
                                   const PlanePoint<M>& p) {
  using Real = typename M::Real;
  const Real g = Radial::template radial_factor<M>(c, M::min(p.s, limit)).value;
  LensPoint<M> out = {p.x * g, p.y * g, M::both(p.seen, p.s <= limit)};
  if constexpr (requires { c.p1; }) {
    const Real p1 = M::constant(c.p1), p2 = M::constant(c.p2), two = M::constant(2);
    out.x = out.x + two * p1 * p.x * p.y + p2 * (p.s + two * p.x * p.x);
    out.y = out.y + p1 * (p.s + two * p.y * p.y) + two * p2 * p.x * p.y;
  }
  if constexpr (requires { c.sx1; }) {
    out.x = out.x + M::constant(c.sx1) * p.s;
    out.y = out.y + M::constant(c.sy1) * p.s;
  }
  if constexpr (requires { c.sx2; }) {
    const Real s2 = p.s * p.s;
    out.x = out.x + M::constant(c.sx2) * s2;
    out.y = out.y + M::constant(c.sy2) * s2;
  }
  if constexpr (requires { c.shear_x; }) {
    const Real x = out.x;
    out.x = x + M::constant(c.shear_x) * out.y;
    out.y = out.y + M::constant(c.shear_y) * x;
  }
  return out;
}

/// Derivatives of (x_d, y_d) by x and y.
template <class M>
struct LensSlopes {
  typename M::Real x_by_x, x_by_y, y_by_x, y_by_y;
};

template <class Radial, class M, class Numbers>
REDRIVE_LANES LensSlopes<M> distort_slopes(const Numbers& c, typename M::Real limit,
                                           const PlanePoint<M>& p) {
  using Real = typename M::Real;
  const Real two = M::constant(2);
  const RadialFactor<M> g = Radial::template radial_factor<M>(c, M::min(p.s, limit));
  const Real slope = M::select(p.s < limit, two * g.slope, M::constant(0));
  LensSlopes<M> out;
  out.x_by_x = g.value + slope * p.x * p.x;
  out.y_by_y = g.value + slope * p.y * p.y;
  out.x_by_y = slope * p.x * p.y;
  if constexpr (requires { c.p1; }) {
    const Real p1 = two * M::constant(c.p1), p2 = two * M::constant(c.p2), three = M::constant(3);
    out.x_by_x = out.x_by_x + p1 * p.y + three * p2 * p.x;
    out.y_by_y = out.y_by_y + three * p1 * p.y + p2 * p.x;
    out.x_by_y = out.x_by_y + p1 * p.x + p2 * p.y;
  }
  out.y_by_x = out.x_by_y;
  if constexpr (requires { c.sx1; }) {
    const Real sx1 = two * M::constant(c.sx1), sy1 = two * M::constant(c.sy1);
    out.x_by_x = out.x_by_x + sx1 * p.x;
    out.x_by_y = out.x_by_y + sx1 * p.y;
    out.y_by_x = out.y_by_x + sy1 * p.x;
    out.y_by_y = out.y_by_y + sy1 * p.y;
  }
  if constexpr (requires { c.sx2; }) {
    const Real s4 = M::constant(4) * p.s, sx2 = s4 * M::constant(c.sx2),
               sy2 = s4 * M::constant(c.sy2);
    out.x_by_x = out.x_by_x + sx2 * p.x;
    out.x_by_y = out.x_by_y + sx2 * p.y;
    out.y_by_x = out.y_by_x + sy2 * p.x;
    out.y_by_y = out.y_by_y + sy2 * p.y;
  }
  if constexpr (requires { c.shear_x; }) {
    const Real shear_x = M::constant(c.shear_x), shear_y = M::constant(c.shear_y),
               x_by_x = out.x_by_x, x_by_y = out.x_by_y;
    out.x_by_x = x_by_x + shear_x * out.y_by_x;
    out.x_by_y = x_by_y + shear_x * out.y_by_y;
    out.y_by_x = out.y_by_x + shear_y * x_by_x;
    out.y_by_y = out.y_by_y + shear_y * x_by_y;
  }
  return out;
}

/// Projects a point of any length to distorted coordinates, pixel = f (x, y) + c.
template <class Model, class M, class Numbers>
REDRIVE_LANES LensPoint<M> project_lens(const Numbers& c, typename M::Real limit,
                                        typename M::Real x, typename M::Real y,
                                        typename M::Real z) {
  return distort<typename Model::Radial, M>(c, limit,
                                            Model::Plane::template project<M>(c, x, y, z));
}

/// Adds the derivatives of x_d d_x + y_d d_y by the point to d_point[3].
template <class Model, class M, class Numbers>
REDRIVE_LANES void project_lens_adjoint(const Numbers& c, typename M::Real limit,
                                        typename M::Real x, typename M::Real y, typename M::Real z,
                                        typename M::Real d_x, typename M::Real d_y,
                                        typename M::Real* d_point) {
  const PlanePoint<M> p = Model::Plane::template project<M>(c, x, y, z);
  const LensSlopes<M> by = distort_slopes<typename Model::Radial, M>(c, limit, p);
  Model::Plane::template adjoint<M>(c, x, y, z, p, d_x * by.x_by_x + d_y * by.y_by_x,
                                    d_x * by.x_by_y + d_y * by.y_by_y, d_point);
}

/// Returns the distorted coordinates of a point, or nothing outside the region in which the model
/// is one-to-one. T: double or a number with derivatives.
template <class Model, class T>
std::optional<std::array<T, 2>> project_point(const Model& model, const std::array<T, 3>& point) {
  using M = NumberMath<T>;
  // The margin is for the rounding of a ray that unproject returned on the edge.
  const double radius = model.max_plane_radius(), limit = radius * radius * (1 + 2e-12);
  const auto& c = model.numbers();
  const PlanePoint<M> p = Model::Plane::template project<M>(c, point[0], point[1], point[2]);
  if (!(p.seen && p.s <= T(limit))) return std::nullopt;
  const LensPoint<M> at = distort<typename Model::Radial, M>(c, T(limit), p);
  return std::array<T, 2>{at.x, at.y};
}

}  // namespace redrive
