// SPDX-License-Identifier: Apache-2.0
// "opencv_rational": the pinhole camera with OpenCV's eight coefficients, COLMAP's FULL_OPENCV.
//   (x, y) = (X/Z, Y/Z), then camera/lenses/brown_conrady.h with the radial factor
//   g(s) = (1 + k1 s + k2 s^2 + k3 s^3) / (1 + k4 s + k5 s^2 + k6 s^3).
#pragma once

#include <array>
#include <limits>
#include <optional>
#include <span>

#include <Eigen/Core>

#include "redrive/camera/calibration.h"
#include "redrive/camera/lenses/opencv_pinhole.h"

namespace redrive {

/// Coefficients in any precision (camera/lenses/lens.h).
template <class S>
struct RationalNumbers {
  S k1, k2, p1, p2, k3, k4, k5, k6;
};

/// Undistorted radii above this are less than 1e-6 rad from 90 degrees, beyond any image.
constexpr double kFarthestPinholeRadius = 1e6;

/// Returns the undistorted radius up to which d(r g)/dr > linear r + cubic r^3 and g's denominator
/// is above 0; infinity if both hold to kFarthestPinholeRadius.
double rational_radius(const RationalNumbers<double>& numbers, double linear, double cubic);

struct OpenCvRational : RationalNumbers<double> {
  static constexpr const char* kName = "opencv_rational";
  static constexpr std::array<CameraParameter, 8> kDistortion{
      {{"k1"}, {"k2"}, {"p1"}, {"p2"}, {"k3"}, {"k4"}, {"k5"}, {"k6"}}};
  static constexpr std::array<CameraParameter, 0> kOther{};
  static constexpr std::array<std::string_view, 0> kTransformsNames{};
  static constexpr bool kPerspective = true, kImageCircle = false;
  static constexpr std::array<double, 8> kTypical{0.2,  -0.1, 0.001, -0.0005,
                                                  0.01, 0.5,  -0.08, 0.02};

  using Plane = PerspectivePlane;
  using Radial = OpenCvRational;
  template <class S>
  using Numbers = RationalNumbers<S>;

  /// Undistorted radius of the disc on which the map is one-to-one, as BrownConrady::max_radius: it
  /// also ends before the denominator reaches 0. Infinity if there is no such radius.
  double max_radius = std::numeric_limits<double>::infinity();

  OpenCvRational() : Numbers<double>{} {}
  /// k1 k2 p1 p2 k3 k4 k5 k6, all finite.
  explicit OpenCvRational(std::span<const double> coefficients);

  template <class M, class C>
  static REDRIVE_LANES RadialFactor<M> radial_factor(const C& c, typename M::Real s) {
    using Real = typename M::Real;
    const Real one = M::constant(1), two = M::constant(2), three = M::constant(3);
    const Real k1 = M::constant(c.k1), k2 = M::constant(c.k2), k3 = M::constant(c.k3),
               k4 = M::constant(c.k4), k5 = M::constant(c.k5), k6 = M::constant(c.k6);
    const Real below = one + s * (k4 + s * (k5 + s * k6)),
               g = (one + s * (k1 + s * (k2 + s * k3))) / below;
    return {
        g, (k1 + s * (two * k2 + s * (three * k3)) - g * (k4 + s * (two * k5 + s * (three * k6)))) /
               below};
  }

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
