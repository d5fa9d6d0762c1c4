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

namespace redrive {

struct Fov {
  static constexpr const char* kName = "fov";
  static constexpr std::array<CameraParameter, 0> kDistortion{};
  static constexpr std::array<CameraParameter, 1> kOther{{{"omega", 0, 3.1}}};
  static constexpr std::array<std::string_view, 0> kTransformsNames{};
  static constexpr bool kPerspective = true, kImageCircle = false;
  static constexpr std::array<double, 1> kTypical{0.9};

  /// Largest omega r_d: directions at a right angle to the axis, which would be at pi / 2, have no
  /// radius.
  static constexpr double kMaxAngle_rad = std::numbers::pi / 2 - 1e-6;

  double omega = 0;
  double slope = 1;  ///< slope of omega r_d at the axis, 2 tan(omega / 2)

  Fov() = default;
  /// omega, in [0, 3.1].
  explicit Fov(std::span<const double> parameters)
      : omega(parameters[0]), slope(2 * std::tan(parameters[0] / 2)) {}

  double covered_radius() const {
    return omega > 0 ? kMaxAngle_rad / omega : std::numeric_limits<double>::infinity();
  }

  /// Returns the distorted normalised coordinates of a point (any length > 0), or nothing behind
  /// the camera.
  template <class T>
  std::optional<std::array<T, 2>> project(const std::array<T, 3>& point) const {
    using std::atan2;
    using std::sqrt;
    const T rr = point[0] * point[0] + point[1] * point[1];
    if (!(point[2] > T(0)) || !(rr >= T(0))) return std::nullopt;  // or NaN
    // This close to the axis atan(x) is x to rounding; on it r_d / r is 0 / 0.
    if (omega == 0 || rr <= T(1e-18) * point[2] * point[2]) {
      const T scale = T(omega == 0 ? 1 : slope / omega) / point[2];
      return std::array<T, 2>{scale * point[0], scale * point[1]};
    }
    const T r = sqrt(rr), angle = atan2(T(slope) * r, point[2]);
    if (!(angle <= T(kMaxAngle_rad * (1 + 1e-12)))) return std::nullopt;
    const T scale = angle / (T(omega) * r);
    return std::array<T, 2>{scale * point[0], scale * point[1]};
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
