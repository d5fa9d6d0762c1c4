// SPDX-License-Identifier: Apache-2.0
// Inverts a distortion by Newton's method on the disc on which it is one-to-one.
#pragma once

#include <limits>
#include <optional>

#include <Eigen/Core>
#include <Eigen/LU>

#include "redrive/camera/lenses/lens.h"
#include "redrive/camera/lenses/roots.h"

namespace redrive {

/// Returns the point of the plane with |x| <= max_radius, the disc on which the distortion is
/// one-to-one, whose image is `distorted`, to 1e-12 (1 + |distorted|), or nothing if there is none.
/// Newton's method from the point without tangential terms: steps that leave the disc or do not
/// lower the residual are halved.
template <class Radial, class Numbers>
std::optional<Eigen::Vector2d> invert_on_disc(const Numbers& c, const Eigen::Vector2d& distorted,
                                              double max_radius) {
  using M = NumberMath<double>;
  constexpr double kNoLimit = std::numeric_limits<double>::infinity();
  const auto plane_point = [](const Eigen::Vector2d& x) {
    return PlanePoint<M>{x.x(), x.y(), x.squaredNorm(), true};
  };
  const auto residual = [&](const Eigen::Vector2d& x) {
    const LensPoint<M> at = distort<Radial, M>(c, kNoLimit, plane_point(x));
    return Eigen::Vector2d(at.x - distorted.x(), at.y - distorted.y());
  };
  const auto factor = [&](double r) { return Radial::template radial_factor<M>(c, r * r); };
  const double length = distorted.norm();
  if (length == 0) return distorted;
  const double start = increasing_root([&](double r) { return r * factor(r).value; },
                                       [&](double r) {
                                         const RadialFactor<M> g = factor(r);
                                         return g.value + 2 * r * r * g.slope;
                                       },
                                       length, length, max_radius);
  Eigen::Vector2d x = distorted * (start / length);
  Eigen::Vector2d error = residual(x);
  for (int iteration = 0; iteration < 60 && error.norm() > 1e-14 * (1 + length); ++iteration) {
    const LensSlopes<M> by = distort_slopes<Radial, M>(c, kNoLimit, plane_point(x));
    Eigen::Matrix2d jacobian;
    jacobian << by.x_by_x, by.x_by_y, by.y_by_x, by.y_by_y;
    Eigen::Vector2d step = jacobian.inverse() * error, next = x - step;
    Eigen::Vector2d next_error = residual(next);
    int halvings = 0;
    while ((!(next.norm() <= max_radius) || !(next_error.norm() < error.norm())) && halvings < 30) {
      step *= 0.5;
      next = x - step;
      next_error = residual(next);
      ++halvings;
    }
    if (halvings == 30) break;  // rounding error, or the edge of the disc
    x = next;
    error = next_error;
  }
  if (!(error.norm() <= 1e-12 * (1 + length)) || !(x.norm() <= max_radius)) return std::nullopt;
  return x;
}

/// Returns the direction (x, y, 1) that a pinhole distorts to `distorted`, or nothing.
template <class Radial, class Numbers>
std::optional<Eigen::Vector3d> unproject_pinhole(const Numbers& c, const Eigen::Vector2d& distorted,
                                                 double max_radius) {
  if (!distorted.allFinite()) return std::nullopt;
  const auto m = invert_on_disc<Radial>(c, distorted, max_radius);
  if (!m) return std::nullopt;
  return Eigen::Vector3d(m->x(), m->y(), 1);
}

}  // namespace redrive
