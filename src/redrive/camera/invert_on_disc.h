// SPDX-License-Identifier: Apache-2.0
// Inverts a distortion by Newton's method on the disc on which it is one-to-one.
#pragma once

#include <array>
#include <optional>

#include <Eigen/Core>
#include <Eigen/LU>

#include "redrive/math/dual.h"

namespace redrive {

/// Returns the x with |x| <= max_radius and map(x) = target, to 1e-12 (1 + |target|), or nothing if
/// there is none. `map` and `jacobian` take an Eigen::Vector2d. Newton's method from `start`: steps
/// that leave the disc or do not lower the residual are halved.
template <class Map, class Jacobian>
std::optional<Eigen::Vector2d> invert_on_disc(const Map& map, const Jacobian& jacobian,
                                              const Eigen::Vector2d& target,
                                              const Eigen::Vector2d& start, double max_radius) {
  const auto residual = [&](const Eigen::Vector2d& x) -> Eigen::Vector2d {
    return map(x) - target;
  };
  const double length = target.norm();
  Eigen::Vector2d x = start;
  Eigen::Vector2d error = residual(x);
  for (int iteration = 0; iteration < 60 && error.norm() > 1e-14 * (1 + length); ++iteration) {
    Eigen::Vector2d step = jacobian(x).inverse() * error, next = x - step;
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

/// The same for a lens with a `distort` templated on its scalar, which is differentiated
/// automatically.
template <class Lens>
std::optional<Eigen::Vector2d> invert_on_disc(const Lens& lens, const Eigen::Vector2d& target,
                                              const Eigen::Vector2d& start, double max_radius) {
  return invert_on_disc(
      [&](const Eigen::Vector2d& x) {
        const std::array<double, 2> d = lens.template distort<double>({x.x(), x.y()});
        return Eigen::Vector2d(d[0], d[1]);
      },
      [&](const Eigen::Vector2d& x) {
        const std::array<Dual, 2> d = lens.template distort<Dual>({Dual(x.x(), 0), Dual(x.y(), 1)});
        Eigen::Matrix2d j;
        j << d[0].d[0], d[0].d[1], d[1].d[0], d[1].d[1];
        return j;
      },
      target, start, max_radius);
}

}  // namespace redrive
