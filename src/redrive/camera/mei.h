// SPDX-License-Identifier: Apache-2.0
// "mei", for fisheyes: the unified model of Mei and Rives (ICRA 2007, section II), as in OpenCV's
// omnidir.
//   (X, Y, Z)/|.| -> (x, y) = (X/(Z + xi), Y/(Z + xi)) on the unit sphere, then
//   camera/brown_conrady.h.
// Inverse (the lift): with s = x^2 + y^2, f = (xi + sqrt(1 + (1 - xi^2) s)) / (s + 1), direction (f
// x, f y, f - xi). At angle a from the axis r = sin a / (cos a + xi) grows until cos a = -xi (xi <=
// 1, r = infinity) or cos a = -1/xi (xi > 1, r = 1/sqrt(xi^2 - 1), where the root of the lift is
// 0); directions further back have no pixel.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <span>

#include <Eigen/Core>

#include "redrive/camera/brown_conrady.h"
#include "redrive/camera/calibration.h"

namespace redrive {

struct Mei {
  static constexpr const char* kName = "mei";
  static constexpr auto kDistortion = BrownConrady::kParameters;
  static constexpr std::array<CameraParameter, 1> kOther{{{"xi", 0, 10}}};
  static constexpr std::array<std::string_view, 0> kTransformsNames{};
  static constexpr bool kPerspective = false, kImageCircle = true;
  static constexpr std::array<double, 6> kTypical{0.03, -0.08, 0, 0, 0, 1.02};

  BrownConrady distortion;  ///< max_radius: the lens's or the sphere's, whichever is smaller
  double xi = 0;            ///< distance of the projection centre from the sphere's centre, >= 0:
                            ///< 0 pinhole, 1 parabolic mirror, fisheyes up to 3

  Mei() = default;
  /// k1 k2 p1 p2 k3 xi, all finite.
  explicit Mei(std::span<const double> parameters)
      : distortion(parameters.first<5>()), xi(parameters[5]) {
    // 1e-9: on the edge of the sphere the angle is accurate to the square root of a rounding error.
    if (xi > 1)
      distortion.max_radius = std::min(distortion.max_radius, (1 - 1e-9) / std::sqrt(xi * xi - 1));
  }

  double covered_radius() const { return distortion.covered_radius(); }

  /// Returns the distorted normalised coordinates of a point (any length > 0), or nothing beyond
  /// the edge of the sphere or the fold.
  template <class T>
  std::optional<std::array<T, 2>> project(const std::array<T, 3>& point) const {
    using std::sqrt;
    const T length = sqrt(point[0] * point[0] + point[1] * point[1] + point[2] * point[2]);
    if (!(length > T(0)) || !(point[2] > length * T(xi > 1 ? -1 / xi : -xi))) return std::nullopt;
    const T w = point[2] + T(xi) * length;
    const std::array<T, 2> m{point[0] / w, point[1] / w};
    if (!(m[0] * m[0] + m[1] * m[1] <=
          T(distortion.max_radius * distortion.max_radius * (1 + 1e-12))))
      return std::nullopt;
    return distortion.distort(m);
  }

  /// Returns the unit direction that is projected to `distorted`, or nothing.
  std::optional<Eigen::Vector3d> unproject(const Eigen::Vector2d& distorted) const {
    const std::optional<Eigen::Vector2d> m = distortion.undistort(distorted);
    if (!m) return std::nullopt;
    const double s = m->squaredNorm(), root = 1 + (1 - xi * xi) * s;
    if (!(root >= 0)) return std::nullopt;
    const double f = (xi + std::sqrt(root)) / (s + 1);
    return Eigen::Vector3d(f * m->x(), f * m->y(), f - xi);
  }
};

}  // namespace redrive
