// SPDX-License-Identifier: Apache-2.0
// "opencv_thin_prism": the pinhole camera with OpenCV's twelve coefficients, NCore's and the
// simulators' pinhole. It adds a thin prism to camera/lenses/opencv_rational.h; the terms s1 and s3
// are in Weng, Cohen and Herniou (PAMI 1992):
//   x_d += s1 s + s2 s^2,   y_d += s3 s + s4 s^2.
#pragma once

#include <array>
#include <limits>
#include <optional>
#include <span>

#include <Eigen/Core>

#include "redrive/camera/calibration.h"
#include "redrive/camera/lenses/opencv_rational.h"

namespace redrive {

/// Coefficients in any precision (camera/lenses/lens.h); sx1 sx2 sy1 sy2 are s1 s2 s3 s4.
template <class S>
struct OpenCvThinPrismNumbers {
  S k1, k2, p1, p2, k3, k4, k5, k6, sx1, sx2, sy1, sy2;
};

struct OpenCvThinPrism : OpenCvThinPrismNumbers<double> {
  static constexpr const char* kName = "opencv_thin_prism";
  static constexpr std::array<CameraParameter, 12> kDistortion{{{"k1"},
                                                                {"k2"},
                                                                {"p1"},
                                                                {"p2"},
                                                                {"k3"},
                                                                {"k4"},
                                                                {"k5"},
                                                                {"k6"},
                                                                {"s1"},
                                                                {"s2"},
                                                                {"s3"},
                                                                {"s4"}}};
  static constexpr std::array<CameraParameter, 0> kOther{};
  static constexpr std::array<std::string_view, 0> kTransformsNames{};
  static constexpr bool kPerspective = true, kImageCircle = false;
  static constexpr std::array<double, 12> kTypical{0.2,   -0.1, 0.001, -0.0005, 0.01,    0.5,
                                                   -0.08, 0.02, 0.001, -0.0004, -0.0007, 0.0002};

  using Plane = PerspectivePlane;
  using Radial = OpenCvRational;
  template <class S>
  using Numbers = OpenCvThinPrismNumbers<S>;

  /// Undistorted radius of the disc on which the map is one-to-one: where the symmetric part of its
  /// Jacobian is positive definite. In radial and tangential direction, at the angle a to (p2, p1),
  /// (s1, s3) and (s2, s4), it is the diagonal (d(r g)/dr, g) and
  ///   |p| r (6 cos a, 2 sin a; 2 sin a, 2 cos a),  |(s1, s3)| r (2 cos a, sin a; sin a, 0),
  ///   |(s2, s4)| r^3 (4 cos a, 2 sin a; 2 sin a, 0).
  /// Where d(r g)/dr > m r + q r^3 up to that radius, g > m r / 2 + q r^3 / 4. With m = 20/3 |p| +
  /// 2 |(s1, s3)| and q = 8/sqrt(3) |(s2, s4)|, each part and its share of that diagonal have no
  /// negative determinant at any angle. It also ends before the denominator reaches 0. Infinity if
  /// there is no such radius.
  double max_radius = std::numeric_limits<double>::infinity();

  OpenCvThinPrism() : Numbers<double>{} {}
  /// k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4, all finite.
  explicit OpenCvThinPrism(std::span<const double> coefficients);

  const Numbers<double>& numbers() const { return *this; }
  double max_plane_radius() const { return max_radius; }
  double covered_radius() const;

  /// Returns the distorted normalised coordinates of a point (any length), or nothing behind the
  /// camera or beyond the fold.
  template <class T>
  std::optional<std::array<T, 2>> project(const std::array<T, 3>& point) const {
    return project_point(*this, point);
  }

  /// Returns the direction (not normalised) that is projected to `distorted`, or nothing.
  std::optional<Eigen::Vector3d> unproject(const Eigen::Vector2d& distorted) const;
};

}  // namespace redrive
