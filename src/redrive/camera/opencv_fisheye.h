// SPDX-License-Identifier: Apache-2.0
// "opencv_fisheye": the fisheye of Kannala and Brandt (PAMI 2006, eq. 6) with OpenCV's four
// coefficients. At angle a from the axis
//   (X, Y, Z) -> theta(a) (X, Y) / sqrt(X^2 + Y^2),   theta(a) = a (1 + k1 a^2 + k2 a^4 + k3 a^6 +
//   k4 a^8).
#pragma once

#include <array>
#include <cmath>
#include <numbers>
#include <optional>
#include <span>

#include <Eigen/Core>

#include "redrive/camera/calibration.h"
#include "redrive/camera/roots.h"

namespace redrive {

struct OpenCvFisheye {
  static constexpr const char* kName = "opencv_fisheye";
  static constexpr std::array<CameraParameter, 4> kDistortion{{{"k1"}, {"k2"}, {"k3"}, {"k4"}}};
  static constexpr std::array<CameraParameter, 0> kOther{};
  static constexpr std::array<std::string_view, 1> kTransformsNames{"OPENCV_FISHEYE"};
  static constexpr bool kPerspective = false, kImageCircle = false;
  static constexpr std::array<double, 4> kTypical{0.03, 0.005, 0.0007, -0.0001};

  double k1 = 0, k2 = 0, k3 = 0, k4 = 0;

  /// Edge of the valid region. Beyond it theta falls, and a second, wrong direction would land in
  /// the image. At most pi (1 - 1e-9): the direction straight behind has no pixel.
  double max_angle_rad = std::numbers::pi * (1 - 1e-9);

  OpenCvFisheye() = default;
  /// k1 k2 k3 k4, all finite.
  explicit OpenCvFisheye(std::span<const double> c) : k1(c[0]), k2(c[1]), k3(c[2]), k4(c[3]) {
    const std::vector<double> folds =
        sign_changes({1, 0, 3 * k1, 0, 5 * k2, 0, 7 * k3, 0, 9 * k4}, max_angle_rad);
    if (!folds.empty()) max_angle_rad = folds.front();
  }

  /// theta(a), radians.
  template <class T>
  T distort(const T& a) const {
    const T s = a * a;
    return a * (T(1) + s * (T(k1) + s * (T(k2) + s * (T(k3) + s * T(k4)))));
  }

  double covered_radius() const { return distort(max_angle_rad); }

  /// Returns the distorted normalised coordinates of a point (any length > 0), or nothing beyond
  /// max_angle_rad.
  template <class T>
  std::optional<std::array<T, 2>> project(const std::array<T, 3>& point) const {
    using std::atan2;
    using std::sqrt;
    const T rr = point[0] * point[0] + point[1] * point[1];
    // This close to the axis theta / r is 1 / Z to rounding; on it the quotient is 0 / 0.
    if (point[2] > T(0) && rr <= T(1e-18) * point[2] * point[2])
      return std::array<T, 2>{point[0] / point[2], point[1] / point[2]};
    const T r = sqrt(rr), angle = atan2(r, point[2]);
    // 1e-12: margin for rounding of a ray that unproject returned on the edge.
    if (!(r > T(0)) || !(angle <= T(max_angle_rad * (1 + 1e-12)))) return std::nullopt;
    const T scale = distort(angle) / r;
    return std::array<T, 2>{scale * point[0], scale * point[1]};
  }

  /// Returns the unit direction that is projected to `distorted`, or nothing.
  std::optional<Eigen::Vector3d> unproject(const Eigen::Vector2d& distorted) const {
    const double theta = distorted.norm();
    if (!(theta <= distort(max_angle_rad))) return std::nullopt;
    if (theta == 0) return Eigen::Vector3d(0, 0, 1);
    const auto slope = [&](double a) {
      const double s = a * a;
      return 1 + s * (3 * k1 + s * (5 * k2 + s * (7 * k3 + s * 9 * k4)));
    };
    const double angle =
        increasing_root([&](double a) { return distort(a); }, slope, theta, theta, max_angle_rad);
    const Eigen::Vector2d sideways = distorted * (std::sin(angle) / theta);
    return Eigen::Vector3d(sideways.x(), sideways.y(), std::cos(angle));
  }
};

}  // namespace redrive
