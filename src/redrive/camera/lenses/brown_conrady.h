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
#include "redrive/camera/lenses/lens.h"

namespace redrive {

/// Coefficients in any precision (camera/lenses/lens.h).
template <class S>
struct BrownConradyNumbers {
  S k1, k2, p1, p2, k3;
};

struct BrownConrady : BrownConradyNumbers<double> {
  static constexpr std::array<CameraParameter, 5> kParameters{
      {{"k1"}, {"k2"}, {"p1"}, {"p2"}, {"k3"}}};
  /// Undistorted radius of the disc on which the map is one-to-one: the valid region. Beyond it the
  /// polynomial folds back, and two points have the same image. Infinity if it never folds.
  double max_radius = std::numeric_limits<double>::infinity();

  BrownConrady() : BrownConradyNumbers<double>{} {}
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

  template <class M, class Numbers>
  static REDRIVE_LANES RadialFactor<M> radial_factor(const Numbers& c, typename M::Real s) {
    const typename M::Real k1 = M::constant(c.k1), k2 = M::constant(c.k2), k3 = M::constant(c.k3);
    return {M::constant(1) + s * (k1 + s * (k2 + s * k3)),
            k1 + s * (M::constant(2) * k2 + s * (M::constant(3) * k3))};
  }

  /// Returns the point of the disc whose image is `distorted`, by Newton's method to
  /// 1e-12 (1 + |distorted|), or nothing if the image of the disc does not contain it.
  std::optional<Eigen::Vector2d> undistort(const Eigen::Vector2d& distorted) const;
};

}  // namespace redrive
