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

#include "redrive/camera/calibration.h"
#include "redrive/camera/lenses/opencv_fisheye.h"

namespace redrive {

/// Coefficients in any precision (camera/lenses/lens.h).
template <class S>
struct ThinPrismNumbers {
  S k1, k2, p1, p2, k3, k4, sx1, sy1;
};

struct ThinPrismFisheye : ThinPrismNumbers<double> {
  static constexpr const char* kName = "thin_prism_fisheye";
  static constexpr std::array<CameraParameter, 8> kDistortion{
      {{"k1"}, {"k2"}, {"p1"}, {"p2"}, {"k3"}, {"k4"}, {"sx1"}, {"sy1"}}};
  static constexpr std::array<CameraParameter, 0> kOther{};
  static constexpr std::array<std::string_view, 0> kTransformsNames{};
  static constexpr bool kPerspective = false, kImageCircle = false;
  static constexpr std::array<double, 8> kTypical{0.03,   0.005,   0.0002, -0.0003,
                                                  0.0007, -0.0001, 0.0004, -0.0002};

  using Plane = EquidistantPlane;
  using Radial = OpenCvFisheye;
  template <class S>
  using Numbers = ThinPrismNumbers<S>;

  /// Angle up to which the map is one-to-one, as OpenCvThinPrism::max_radius: the derivative of a g
  /// exceeds (20/3 |p| + 2 |(sx1, sy1)|) a. At most pi (1 - 1e-9).
  double max_angle_rad = std::numbers::pi * (1 - 1e-9);

  ThinPrismFisheye() : Numbers<double>{} {}
  /// k1 k2 p1 p2 k3 k4 sx1 sy1, all finite.
  explicit ThinPrismFisheye(std::span<const double> coefficients);

  const Numbers<double>& numbers() const { return *this; }
  double max_plane_radius() const { return max_angle_rad; }
  double covered_radius() const;

  /// Returns the distorted normalised coordinates of a point (any length > 0), or nothing beyond
  /// max_angle_rad.
  template <class T>
  std::optional<std::array<T, 2>> project(const std::array<T, 3>& point) const {
    return project_point(*this, point);
  }

  /// Returns the unit direction that is projected to `distorted`, or nothing.
  std::optional<Eigen::Vector3d> unproject(const Eigen::Vector2d& distorted) const;
};

}  // namespace redrive
