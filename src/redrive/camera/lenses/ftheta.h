// SPDX-License-Identifier: Apache-2.0
// "ftheta" and "ftheta_inverse": NVIDIA's f-theta lens, a polynomial between the angle a from the
// axis and the distance r from the principal point, and a shear (NCore's and gsplat's
// FThetaCameraModelParameters). In lengths of fx and fy
//   (X, Y, Z) -> (x, y) = r (X, Y) / sqrt(X^2 + Y^2),  x_d = x + shear_x y,  y_d = y + shear_y x,
// "ftheta":          r(a) = a + k2 a^2 + k3 a^3 + k4 a^4 + k5 a^5,
// "ftheta_inverse":  a(r) = r + k2 r^2 + k3 r^3 + k4 r^4 + k5 r^5, whose inverse is exact, too.
// The angle may exceed 90 degrees.
#pragma once

#include <array>
#include <cmath>
#include <numbers>
#include <optional>
#include <span>
#include <type_traits>

#include <Eigen/Core>

#include "redrive/camera/calibration.h"
#include "redrive/camera/lenses/opencv_fisheye.h"

namespace redrive {

/// Coefficients in any precision (camera/lenses/lens.h).
template <class S>
struct FThetaNumbers {
  S k2, k3, k4, k5, shear_x, shear_y;
  S max_radius;  ///< r at the edge of the valid region
};

/// Parameters and valid region that both models have.
struct FThetaLens : FThetaNumbers<double> {
  static constexpr std::array<CameraParameter, 4> kDistortion{{{"k2"}, {"k3"}, {"k4"}, {"k5"}}};
  static constexpr std::array<CameraParameter, 3> kOther{
      {{"shear_x", -0.5, 0.5}, {"shear_y", -0.5, 0.5}, {"max_angle", 1e-3, std::numbers::pi}}};
  static constexpr std::array<std::string_view, 0> kTransformsNames{};
  static constexpr bool kPerspective = false, kImageCircle = false;

  using Plane = EquidistantPlane;
  template <class S>
  using Numbers = FThetaNumbers<S>;

  /// Edge of the valid region: max_angle, at most pi (1 - 1e-9), less where the polynomial's slope
  /// falls below kLeastSlope.
  double max_angle_rad = std::numbers::pi * (1 - 1e-9);
  static constexpr double kLeastSlope = 0.1;

  const Numbers<double>& numbers() const { return *this; }
  double max_plane_radius() const { return max_angle_rad; }
  double covered_radius() const;

 protected:
  FThetaLens() : Numbers<double>{} {}
  /// k2 k3 k4 k5 shear_x shear_y max_angle.
  explicit FThetaLens(std::span<const double> c);

  /// t + k2 t^2 + ... and its slope.
  template <class M, class C>
  static REDRIVE_LANES RadialFactor<M> polynomial(const C& c, typename M::Real t) {
    const typename M::Real one = M::constant(1), k2 = M::constant(c.k2), k3 = M::constant(c.k3),
                           k4 = M::constant(c.k4), k5 = M::constant(c.k5);
    return {t * (one + t * (k2 + t * (k3 + t * (k4 + t * k5)))),
            one + t * (M::constant(2) * k2 +
                       t * (M::constant(3) * k3 +
                            t * (M::constant(4) * k4 + t * M::constant(5) * k5)))};
  }
  /// r / a and its derivative by s = a^2. On the axis r / a is 1.
  template <class M>
  static REDRIVE_LANES RadialFactor<M> factor_of(typename M::Real s, typename M::Real angle,
                                                 typename M::Real radius, typename M::Real slope) {
    const typename M::Real zero = M::constant(0), one = M::constant(1);
    const auto near = s <= M::constant(EquidistantPlane::kOnAxis);
    const typename M::Real g = M::select(near, one, radius / angle);
    return {g, M::select(near, zero, (slope - g) / (M::constant(2) * s))};
  }
  /// Returns the least length that the shear leaves of a length.
  double least_sheared(double length) const;
  /// Returns the t up to which the polynomial increases, at most `end`.
  double increases_to(double end) const;
  /// Returns the unit direction of a point whose distance is within max_radius, or nothing.
  /// angle_at: returns the angle at a distance.
  template <class Angle>
  std::optional<Eigen::Vector3d> direction(const Eigen::Vector2d& distorted,
                                           const Angle& angle_at) const {
    const Eigen::Vector2d point = Eigen::Vector2d(distorted.x() - shear_x * distorted.y(),
                                                  distorted.y() - shear_y * distorted.x()) /
                                  (1 - shear_x * shear_y);
    const double r = point.norm();
    if (!(r <= max_radius)) return std::nullopt;
    if (r == 0) return Eigen::Vector3d::UnitZ();
    return EquidistantPlane::unproject(point * (angle_at(r) / r));
  }
};

struct FTheta : FThetaLens {
  static constexpr const char* kName = "ftheta";
  static constexpr std::array<double, 7> kTypical{0.001,  0.02,    -0.003, 0.0008,
                                                  0.0006, -0.0002, 1.9};

  using Radial = FTheta;

  FTheta() = default;
  /// k2 k3 k4 k5 shear_x shear_y max_angle, all finite.
  explicit FTheta(std::span<const double> c);

  /// r / a.
  template <class M, class C>
  static REDRIVE_LANES RadialFactor<M> radial_factor(const C& c, typename M::Real s) {
    const typename M::Real angle = M::sqrt(s);
    const RadialFactor<M> r = polynomial<M>(c, angle);
    return factor_of<M>(s, angle, r.value, r.slope);
  }

  /// Returns the distorted normalised coordinates of a point (any length > 0), or nothing beyond
  /// max_angle_rad.
  template <class T>
  std::optional<std::array<T, 2>> project(const std::array<T, 3>& point) const {
    return project_point(*this, point);
  }
  /// Returns the unit direction that is projected to `distorted`, or nothing.
  std::optional<Eigen::Vector3d> unproject(const Eigen::Vector2d& distorted) const;
};

struct FThetaInverse : FThetaLens {
  static constexpr const char* kName = "ftheta_inverse";
  static constexpr std::array<double, 7> kTypical{-0.001, -0.02,   0.003, -0.0008,
                                                  0.0006, -0.0002, 1.9};
  /// Newton's steps from r = a to the rounding of C's numbers, for lenses whose r and a differ by
  /// less than half.
  template <class C>
  static constexpr int kSteps = std::is_same_v<decltype(C::k2), double> ? 8 : 5;

  using Radial = FThetaInverse;

  FThetaInverse() = default;
  /// k2 k3 k4 k5 shear_x shear_y max_angle, all finite.
  explicit FThetaInverse(std::span<const double> c);

  /// r / a, by Newton's method.
  template <class M, class C>
  static REDRIVE_LANES RadialFactor<M> radial_factor(const C& c, typename M::Real s) {
    const typename M::Real angle = M::sqrt(s), most = M::constant(c.max_radius),
                           zero = M::constant(0);
    typename M::Real r = M::min(angle, most);
    for (int i = 0; i < kSteps<C>; ++i) {
      const RadialFactor<M> a = polynomial<M>(c, r);
      r = M::max(zero, M::min(most, r - (a.value - angle) / a.slope));
    }
    return factor_of<M>(s, angle, r, M::constant(1) / polynomial<M>(c, r).slope);
  }

  /// Returns the same as FTheta::project.
  template <class T>
  std::optional<std::array<T, 2>> project(const std::array<T, 3>& point) const {
    return project_point(*this, point);
  }
  /// Returns the same as FTheta::unproject.
  std::optional<Eigen::Vector3d> unproject(const Eigen::Vector2d& distorted) const;
};

}  // namespace redrive
