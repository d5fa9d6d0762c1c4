// SPDX-License-Identifier: Apache-2.0
// "opencv_rational": the pinhole camera with OpenCV's eight coefficients, COLMAP's FULL_OPENCV.
//   (x, y) = (X/Z, Y/Z), then camera/brown_conrady.h with the radial factor
//   g(s) = (1 + k1 s + k2 s^2 + k3 s^3) / (1 + k4 s + k5 s^2 + k6 s^3).
#pragma once

#include <array>
#include <limits>
#include <optional>
#include <span>

#include <Eigen/Core>

#include "redrive/camera/brown_conrady.h"
#include "redrive/camera/calibration.h"

namespace redrive {

struct OpenCvRational {
  static constexpr const char* kName = "opencv_rational";
  static constexpr std::array<CameraParameter, 8> kDistortion{
      {{"k1"}, {"k2"}, {"p1"}, {"p2"}, {"k3"}, {"k4"}, {"k5"}, {"k6"}}};
  static constexpr std::array<CameraParameter, 0> kOther{};
  static constexpr std::array<std::string_view, 0> kTransformsNames{};
  static constexpr bool kPerspective = true, kImageCircle = false;
  static constexpr std::array<double, 8> kTypical{0.2,  -0.1, 0.001, -0.0005,
                                                  0.01, 0.5,  -0.08, 0.02};

  double k1 = 0, k2 = 0, p1 = 0, p2 = 0, k3 = 0, k4 = 0, k5 = 0, k6 = 0;

  /// Undistorted radius of the disc on which the map is one-to-one, as BrownConrady::max_radius: it
  /// also ends before the denominator reaches 0. Infinity if there is no such radius.
  double max_radius = std::numeric_limits<double>::infinity();

  OpenCvRational() = default;
  /// k1 k2 p1 p2 k3 k4 k5 k6, all finite.
  explicit OpenCvRational(std::span<const double> coefficients);

  template <class T>
  T radial_factor(const T& s) const {
    return (T(1) + s * (T(k1) + s * (T(k2) + s * T(k3)))) /
           (T(1) + s * (T(k4) + s * (T(k5) + s * T(k6))));
  }
  template <class T>
  std::array<T, 2> distort(const std::array<T, 2>& point) const {
    const T s = point[0] * point[0] + point[1] * point[1];
    return with_tangential(point, radial_factor(s), p1, p2);
  }

  double covered_radius() const;

  /// Returns the distorted normalised coordinates of a point (any length), or nothing behind the
  /// camera or beyond the fold.
  template <class T>
  std::optional<std::array<T, 2>> project(const std::array<T, 3>& point) const {
    if (!(point[2] > T(0))) return std::nullopt;
    const std::array<T, 2> m{point[0] / point[2], point[1] / point[2]};
    // 1e-12: margin for rounding of a ray that unproject returned on the edge.
    if (!(m[0] * m[0] + m[1] * m[1] <= T(max_radius * max_radius * (1 + 1e-12))))
      return std::nullopt;
    return distort(m);
  }

  /// Returns the direction (not normalised) that is projected to `distorted`, or nothing.
  std::optional<Eigen::Vector3d> unproject(const Eigen::Vector2d& distorted) const;
};

}  // namespace redrive
