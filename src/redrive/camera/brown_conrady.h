// SPDX-License-Identifier: Apache-2.0
// Lens distortion with OpenCV's five coefficients (Brown 1966, Conrady 1919), for the models
// pinhole and mei.
//   s = x^2 + y^2,  g(s) = 1 + k1 s + k2 s^2 + k3 s^3
//   x_d = x g + 2 p1 x y + p2 (s + 2 x^2),   y_d = y g + p1 (s + 2 y^2) + 2 p2 x y
// on normalised coordinates (no unit; pixel = f x_d + c).
#pragma once

#include <array>
#include <limits>
#include <optional>
#include <span>

#include <Eigen/Core>

#include "redrive/camera/calibration.h"

namespace redrive {

/// Returns the point times its radial factor g, with the tangential terms of p1 and p2.
template <class T>
std::array<T, 2> with_tangential(const std::array<T, 2>& point, const T& g, double p1, double p2) {
  const T& x = point[0];
  const T& y = point[1];
  const T xx = x * x, yy = y * y, xy = x * y, s = xx + yy;
  return {x * g + T(2 * p1) * xy + T(p2) * (s + T(2) * xx),
          y * g + T(p1) * (s + T(2) * yy) + T(2 * p2) * xy};
}

struct BrownConrady {
  static constexpr std::array<CameraParameter, 5> kParameters{
      {{"k1"}, {"k2"}, {"p1"}, {"p2"}, {"k3"}}};
  double k1 = 0, k2 = 0, p1 = 0, p2 = 0, k3 = 0;

  /// Undistorted radius of the disc on which the map is one-to-one: the valid region. Beyond it the
  /// polynomial folds back, and two points have the same image. Infinity if it never folds.
  double max_radius = std::numeric_limits<double>::infinity();

  BrownConrady() = default;
  /// k1 k2 p1 p2 k3, all finite. Finds max_radius: the first r > 0 where d(r g(r^2))/dr = 1 + 3 k1
  /// r^2 + 5 k2 r^4 + 7 k3 r^6 falls to (20/3) |p| r. The map is a gradient (its Jacobian J is
  /// symmetric), so it is one-to-one on a disc where J is positive definite; with p = 0 that ends
  /// exactly where the derivative reaches 0, and with p != 0 the bound keeps det J > 0 for every
  /// angle (the radial entry of J is at least the derivative - 6 |p| r, the tangential one at least
  /// g - 2 |p| r, the mixed one 2 |p| r sin(angle)).
  explicit BrownConrady(std::span<const double, 5> coefficients);

  /// Distance from the principal point, normalised and distorted, within which every point is the
  /// image of one on the disc: r g - 6 |p| r^2 at its edge. Infinity if there is no edge.
  double covered_radius() const;

  template <class T>
  std::array<T, 2> distort(const std::array<T, 2>& point) const {
    const T s = point[0] * point[0] + point[1] * point[1];
    return with_tangential(point, T(1) + s * (T(k1) + s * (T(k2) + s * T(k3))), p1, p2);
  }

  /// Returns the point of the disc whose image is `distorted`, by Newton's method to
  /// 1e-12 (1 + |distorted|), or nothing if the image of the disc does not contain it.
  std::optional<Eigen::Vector2d> undistort(const Eigen::Vector2d& distorted) const;
};

}  // namespace redrive
