// SPDX-License-Identifier: Apache-2.0
// "fov": the field-of-view model of Devernay and Faugeras (Machine Vision and Applications 13,
// 2001, eq. 13) with the one parameter omega, radians. At the radius r = sqrt(X^2 + Y^2) / Z
//   (X, Y, Z) -> r_d (X, Y) / sqrt(X^2 + Y^2),   r_d = atan(2 r tan(omega / 2)) / omega,
// and omega = 0 is a pinhole.
#pragma once

#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>
#include <span>

#include <Eigen/Core>

#include "redrive/camera/calibration.h"
#include "redrive/camera/lenses/opencv_pinhole.h"

namespace redrive {

/// Coefficients in any precision (camera/lenses/lens.h).
template <class S>
struct FovNumbers {
  S omega;
  S slope;  ///< slope of omega r_d at the axis, 2 tan(omega / 2)
};

struct Fov : FovNumbers<double> {
  static constexpr const char* kName = "fov";
  static constexpr std::array<CameraParameter, 0> kDistortion{};
  static constexpr std::array<CameraParameter, 1> kOther{{{"omega", 0, 3.1}}};
  static constexpr std::array<std::string_view, 0> kTransformsNames{};
  static constexpr bool kPerspective = true, kImageCircle = false;
  static constexpr std::array<double, 1> kTypical{0.9};

  /// Largest omega r_d: directions at a right angle to the axis, which would be at pi / 2, have no
  /// radius.
  static constexpr double kMaxAngle_rad = std::numbers::pi / 2 - 1e-6;

  using Plane = PerspectivePlane;
  using Radial = Fov;
  template <class S>
  using Numbers = FovNumbers<S>;

  Fov() : Numbers<double>{} {}
  /// omega, in [0, 3.1].
  explicit Fov(std::span<const double> parameters)
      : Numbers<double>{parameters[0], 2 * std::tan(parameters[0] / 2)} {}

  /// r_d / r.
  template <class M, class C>
  static REDRIVE_LANES RadialFactor<M> radial_factor(const C& c, typename M::Real s) {
    using Real = typename M::Real;
    const Real zero = M::constant(0), one = M::constant(1);
    if (c.omega == 0) return {one, zero};
    const Real omega = M::constant(c.omega), slope = M::constant(c.slope), r = M::sqrt(s);
    // This close to the axis atan(x) is x to rounding; on it r_d / r is 0 / 0.
    const auto near = s <= M::constant(1e-18f);
    const Real at_axis = slope / omega,
               g = M::select(near, at_axis, M::atan2(slope * r, one) / (omega * r));
    return {
        g, M::select(near, zero, (at_axis / (one + slope * slope * s) - g) / (M::constant(2) * s))};
  }

  const Numbers<double>& numbers() const { return *this; }
  double max_plane_radius() const { return std::tan(kMaxAngle_rad) / slope; }
  double covered_radius() const {
    return omega > 0 ? kMaxAngle_rad / omega : std::numeric_limits<double>::infinity();
  }

  /// Returns the distorted normalised coordinates of a point (any length > 0), or nothing behind
  /// the camera.
  template <class T>
  std::optional<std::array<T, 2>> project(const std::array<T, 3>& point) const {
    return project_point(*this, point);
  }

  /// Returns the direction (not normalised) that is projected to `distorted`, or nothing.
  std::optional<Eigen::Vector3d> unproject(const Eigen::Vector2d& distorted) const {
    const double r_d = distorted.norm();
    if (!std::isfinite(r_d) || !(r_d <= covered_radius())) return std::nullopt;
    if (omega == 0 || r_d == 0) return Eigen::Vector3d(distorted.x(), distorted.y(), 1);
    const Eigen::Vector2d sideways = distorted * (std::tan(omega * r_d) / (slope * r_d));
    return Eigen::Vector3d(sideways.x(), sideways.y(), 1);
  }
};

}  // namespace redrive
