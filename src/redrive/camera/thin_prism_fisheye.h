// SPDX-License-Identifier: Apache-2.0
// "thin_prism_fisheye": COLMAP's THIN_PRISM_FISHEYE, an equidistant fisheye with the tangential and
// thin prism terms of Weng, Cohen and Herniou (PAMI 1992). A direction at the angle a from the axis
// has the point (x, y) = a (X, Y) / sqrt(X^2 + Y^2), and with s = x^2 + y^2
//   x_d = x g + 2 p1 x y + p2 (s + 2 x^2) + sx1 s,   y_d = y g + p1 (s + 2 y^2) + 2 p2 x y + sy1 s,
//   g = 1 + k1 s + k2 s^2 + k3 s^3 + k4 s^4.
#pragma once

#include <array>
#include <cmath>
#include <numbers>
#include <optional>
#include <span>

#include <Eigen/Core>

#include "redrive/camera/brown_conrady.h"
#include "redrive/camera/calibration.h"

namespace redrive {

struct ThinPrismFisheye {
  static constexpr const char* kName = "thin_prism_fisheye";
  static constexpr std::array<CameraParameter, 8> kDistortion{
      {{"k1"}, {"k2"}, {"p1"}, {"p2"}, {"k3"}, {"k4"}, {"sx1"}, {"sy1"}}};
  static constexpr std::array<CameraParameter, 0> kOther{};
  static constexpr std::array<std::string_view, 0> kTransformsNames{};
  static constexpr bool kPerspective = false, kImageCircle = false;
  static constexpr std::array<double, 8> kTypical{0.03,   0.005,   0.0002, -0.0003,
                                                  0.0007, -0.0001, 0.0004, -0.0002};

  double k1 = 0, k2 = 0, p1 = 0, p2 = 0, k3 = 0, k4 = 0, sx1 = 0, sy1 = 0;

  /// Angle up to which the map is one-to-one: on a disc where the symmetric part of its Jacobian is
  /// positive definite. The radial part's eigenvalues are at least m a / 2 where the derivative of
  /// a g exceeds m a at every angle a; the tangential part's are at least -6 |p| a, the prism's -2
  /// |(sx1, sy1)| a, so m = 12 |p| + 4 |(sx1, sy1)|. At most pi (1 - 1e-9).
  double max_angle_rad = std::numbers::pi * (1 - 1e-9);

  ThinPrismFisheye() = default;
  /// k1 k2 p1 p2 k3 k4 sx1 sy1, all finite.
  explicit ThinPrismFisheye(std::span<const double> coefficients);

  /// The radial factor g.
  template <class T>
  T radial_factor(const T& s) const {
    return T(1) + s * (T(k1) + s * (T(k2) + s * (T(k3) + s * T(k4))));
  }
  /// The image of (x, y), in radians.
  template <class T>
  std::array<T, 2> distort(const std::array<T, 2>& point) const {
    const T s = point[0] * point[0] + point[1] * point[1];
    const std::array<T, 2> d = with_tangential(point, radial_factor(s), p1, p2);
    return {d[0] + T(sx1) * s, d[1] + T(sy1) * s};
  }

  double covered_radius() const;

  /// Returns the distorted normalised coordinates of a point (any length > 0), or nothing beyond
  /// max_angle_rad.
  template <class T>
  std::optional<std::array<T, 2>> project(const std::array<T, 3>& point) const {
    using std::atan2;
    using std::sqrt;
    const T rr = point[0] * point[0] + point[1] * point[1];
    // This close to the axis a / r is 1 / Z to rounding; on it the quotient is 0 / 0.
    if (point[2] > T(0) && rr <= T(1e-18) * point[2] * point[2])
      return distort(std::array<T, 2>{point[0] / point[2], point[1] / point[2]});
    const T r = sqrt(rr), angle = atan2(r, point[2]);
    // 1e-12: margin for rounding of a ray that unproject returned on the edge.
    if (!(r > T(0)) || !(angle <= T(max_angle_rad * (1 + 1e-12)))) return std::nullopt;
    const T scale = angle / r;
    return distort(std::array<T, 2>{scale * point[0], scale * point[1]});
  }

  /// Returns the unit direction that is projected to `distorted`, or nothing.
  std::optional<Eigen::Vector3d> unproject(const Eigen::Vector2d& distorted) const;
};

}  // namespace redrive
