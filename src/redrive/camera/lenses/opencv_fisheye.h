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
#include "redrive/camera/lenses/invert_on_disc.h"

namespace redrive {

/// Coefficients in any precision (camera/lenses/lens.h).
template <class S>
struct FisheyeNumbers {
  S k1, k2, k3, k4;
};

/// (x, y) = a / r (X, Y) at the angle a from the axis, r = sqrt(X^2 + Y^2): everywhere but straight
/// behind.
struct EquidistantPlane {
  /// This close to the axis, in r^2 / Z^2, a / r is 1 / Z to rounding; on it the quotient is 0 / 0.
  static constexpr float kOnAxis = 1e-18f;

  template <class M, class Numbers>
  static REDRIVE_LANES PlanePoint<M> project(const Numbers&, typename M::Real x, typename M::Real y,
                                             typename M::Real z) {
    using Real = typename M::Real;
    const Real zero = M::constant(0), rr = x * x + y * y, r = M::sqrt(rr), angle = M::atan2(r, z),
               inverse = M::constant(1) / z;
    const auto near = is_near<M>(rr, z);
    PlanePoint<M> p;
    p.scale = M::select(near, inverse, angle / r);
    p.x = x * p.scale;
    p.y = y * p.scale;
    p.s = M::select(near, rr * inverse * inverse, angle * angle);
    p.seen = M::either(rr > zero, z > zero);
    return p;
  }
  template <class M, class Numbers>
  static REDRIVE_LANES void adjoint(const Numbers&, typename M::Real x, typename M::Real y,
                                    typename M::Real z, const PlanePoint<M>& p,
                                    typename M::Real d_x, typename M::Real d_y,
                                    typename M::Real* d_point) {
    using Real = typename M::Real;
    const Real zero = M::constant(0), rr = x * x + y * y,
               per_square = M::constant(1) / (rr + z * z), d_scale = d_x * x + d_y * y;
    // Derivative of the scale by r, over r.
    const Real by_r = M::select(is_near<M>(rr, z), zero, (z * per_square - p.scale) / rr);
    d_point[0] = d_point[0] + d_x * p.scale + d_scale * by_r * x;
    d_point[1] = d_point[1] + d_y * p.scale + d_scale * by_r * y;
    d_point[2] = d_point[2] - d_scale * per_square;
  }

  /// Returns the unit direction of a point of the plane.
  static Eigen::Vector3d unproject(const Eigen::Vector2d& on_plane) {
    const double angle = on_plane.norm(), scale = angle > 0 ? std::sin(angle) / angle : 1;
    return {scale * on_plane.x(), scale * on_plane.y(), std::cos(angle)};
  }

 private:
  template <class M>
  static REDRIVE_LANES typename M::Mask is_near(typename M::Real rr, typename M::Real z) {
    return M::both(z > M::constant(0), rr <= M::constant(kOnAxis) * z * z);
  }
};

struct OpenCvFisheye : FisheyeNumbers<double> {
  static constexpr const char* kName = "opencv_fisheye";
  static constexpr std::array<CameraParameter, 4> kDistortion{{{"k1"}, {"k2"}, {"k3"}, {"k4"}}};
  static constexpr std::array<CameraParameter, 0> kOther{};
  static constexpr std::array<std::string_view, 1> kTransformsNames{"OPENCV_FISHEYE"};
  static constexpr bool kPerspective = false, kImageCircle = false;
  static constexpr std::array<double, 4> kTypical{0.03, 0.005, 0.0007, -0.0001};

  using Plane = EquidistantPlane;
  using Radial = OpenCvFisheye;
  template <class S>
  using Numbers = FisheyeNumbers<S>;

  /// Edge of the valid region. Beyond it theta falls, and a second, wrong direction would land in
  /// the image. At most pi (1 - 1e-9): the direction straight behind has no pixel.
  double max_angle_rad = std::numbers::pi * (1 - 1e-9);

  OpenCvFisheye() : Numbers<double>{} {}
  /// k1 k2 k3 k4, all finite.
  explicit OpenCvFisheye(std::span<const double> c) : Numbers<double>{c[0], c[1], c[2], c[3]} {
    const std::vector<double> folds =
        sign_changes({1, 0, 3 * k1, 0, 5 * k2, 0, 7 * k3, 0, 9 * k4}, max_angle_rad);
    if (!folds.empty()) max_angle_rad = folds.front();
  }

  /// theta(a) / a.
  template <class M, class C>
  static REDRIVE_LANES RadialFactor<M> radial_factor(const C& c, typename M::Real s) {
    const typename M::Real k1 = M::constant(c.k1), k2 = M::constant(c.k2), k3 = M::constant(c.k3),
                           k4 = M::constant(c.k4);
    return {M::constant(1) + s * (k1 + s * (k2 + s * (k3 + s * k4))),
            k1 + s * (M::constant(2) * k2 + s * (M::constant(3) * k3 + s * (M::constant(4) * k4)))};
  }

  const Numbers<double>& numbers() const { return *this; }
  double max_plane_radius() const { return max_angle_rad; }
  /// theta(max_angle_rad).
  double covered_radius() const {
    const double s = max_angle_rad * max_angle_rad;
    return max_angle_rad * radial_factor<NumberMath<double>>(*this, s).value;
  }

  /// Returns the distorted normalised coordinates of a point (any length > 0), or nothing beyond
  /// max_angle_rad.
  template <class T>
  std::optional<std::array<T, 2>> project(const std::array<T, 3>& point) const {
    return project_point(*this, point);
  }

  /// Returns the unit direction that is projected to `distorted`, or nothing.
  std::optional<Eigen::Vector3d> unproject(const Eigen::Vector2d& distorted) const {
    if (!(distorted.norm() <= covered_radius())) return std::nullopt;
    const auto on_plane = invert_on_disc<OpenCvFisheye>(numbers(), distorted, max_angle_rad);
    if (!on_plane) return std::nullopt;
    return EquidistantPlane::unproject(*on_plane);
  }
};

}  // namespace redrive
