// SPDX-License-Identifier: Apache-2.0
// "double_sphere", for fisheyes: the double sphere camera model of Usenko, Demmel and Cremers (3DV
// 2018, section 4), Kalibr's and Basalt's ds.
//   (X, Y, Z) -> (X, Y) / (alpha d2 + (1 - alpha) k),
//   d1 = sqrt(X^2 + Y^2 + Z^2),   k = xi d1 + Z,   d2 = sqrt(X^2 + Y^2 + k^2).
// Inverse: with s = x^2 + y^2 and
//   m = (1 - alpha^2 s) / (alpha sqrt(1 - (2 alpha - 1) s) + 1 - alpha),
//   f = (m xi + sqrt(m^2 + (1 - xi^2) s)) / (m^2 + s),   direction (f x, f y, f m - xi).
// Directions with k <= -w1 d2 have no pixel, w1 = min(alpha, 1 - alpha) / max(alpha, 1 - alpha):
//   Z <= -w2 d1,   w2 = xi (1 - w1^2) + w1 sqrt(1 - xi^2 (1 - w1^2)).
// The w2 of the paper's equation 45 lies beyond, where two directions have one pixel.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <span>

#include <Eigen/Core>

#include "redrive/camera/calibration.h"
#include "redrive/camera/lenses/mei.h"
#include "redrive/camera/lenses/no_distortion.h"

namespace redrive {

/// Coefficients in any precision (camera/lenses/lens.h).
template <class S>
struct DoubleSphereNumbers {
  S xi, alpha;
  S edge;  ///< w2
};

/// (x, y) = (X, Y) / (alpha d2 + (1 - alpha) k).
struct DoubleSpherePlane {
  template <class M>
  struct Spheres {
    typename M::Real k, d2, w;
  };
  template <class M, class S>
  static REDRIVE_LANES Spheres<M> spheres(const DoubleSphereNumbers<S>& c, typename M::Real x,
                                          typename M::Real y, typename M::Real z,
                                          typename M::Real d1) {
    const typename M::Real alpha = M::constant(c.alpha), k = M::constant(c.xi) * d1 + z,
                           d2 = M::sqrt(x * x + y * y + k * k);
    return {k, d2, alpha * d2 + (M::constant(1) - alpha) * k};
  }
  template <class M, class S>
  static REDRIVE_LANES PlanePoint<M> project(const DoubleSphereNumbers<S>& c, typename M::Real x,
                                             typename M::Real y, typename M::Real z) {
    using Real = typename M::Real;
    PlanePoint<M> p;
    p.length = M::sqrt(x * x + y * y + z * z);
    const Real w = spheres<M>(c, x, y, z, p.length).w,
               least = M::constant(SpherePlane::least_w<S>()) * p.length;
    p.scale = M::constant(1) / M::max(w, least);
    p.x = x * p.scale;
    p.y = y * p.scale;
    p.s = p.x * p.x + p.y * p.y;
    p.seen = M::both(w > least, z + M::constant(c.edge) * p.length > M::constant(0));
    return p;
  }
  template <class M, class S>
  static REDRIVE_LANES void adjoint(const DoubleSphereNumbers<S>& c, typename M::Real x,
                                    typename M::Real y, typename M::Real z, const PlanePoint<M>& p,
                                    typename M::Real d_x, typename M::Real d_y,
                                    typename M::Real* d_point) {
    using Real = typename M::Real;
    const Spheres<M> at = spheres<M>(c, x, y, z, p.length);
    const Real alpha = M::constant(c.alpha), xi = M::constant(c.xi), zero = M::constant(0),
               least = M::constant(SpherePlane::least_w<S>());
    const auto is_least = at.w < least * p.length;
    d_x = d_x * p.scale;
    d_y = d_y * p.scale;
    // w by k, by the length and by X^2 + Y^2 within d2.
    const Real d_w = zero - (d_x * p.x + d_y * p.y),
               by_k = d_w * (alpha * at.k / at.d2 + M::constant(1) - alpha),
               by_length = M::select(is_least, least * d_w, xi * by_k) / p.length,
               by_side = M::select(is_least, zero, alpha * d_w / at.d2);
    d_point[0] = d_point[0] + d_x + (by_length + by_side) * x;
    d_point[1] = d_point[1] + d_y + (by_length + by_side) * y;
    d_point[2] = d_point[2] + by_length * z + M::select(is_least, zero, by_k);
  }
};

struct DoubleSphere : DoubleSphereNumbers<double> {
  static constexpr const char* kName = "double_sphere";
  static constexpr std::array<CameraParameter, 0> kDistortion{};
  static constexpr std::array<CameraParameter, 2> kOther{{{"xi", -0.9, 1}, {"alpha", 0, 1}}};
  static constexpr std::array<std::string_view, 0> kTransformsNames{};
  static constexpr bool kPerspective = false, kImageCircle = false;
  static constexpr std::array<double, 2> kTypical{-0.2, 0.59};

  using Plane = DoubleSpherePlane;
  using Radial = NoDistortion;
  template <class S>
  using Numbers = DoubleSphereNumbers<S>;

  DoubleSphere() : Numbers<double>{0, 0, 0} {}
  /// xi alpha.
  explicit DoubleSphere(std::span<const double> parameters)
      : Numbers<double>{parameters[0], parameters[1], edge_of(parameters[0], parameters[1])} {}

  const Numbers<double>& numbers() const { return *this; }
  /// Where the first root of the inverse is 0; 1e-9 as Mei has it.
  double max_plane_radius() const {
    return alpha > 0.5 ? (1 - 1e-9) / std::sqrt(2 * alpha - 1)
                       : std::numeric_limits<double>::infinity();
  }
  double covered_radius() const { return max_plane_radius(); }

  /// Returns the normalised coordinates of a point (any length > 0), or nothing beyond the edge.
  template <class T>
  std::optional<std::array<T, 2>> project(const std::array<T, 3>& point) const {
    return project_point(*this, point);
  }

  /// Returns the unit direction that is projected to `distorted`, or nothing.
  std::optional<Eigen::Vector3d> unproject(const Eigen::Vector2d& distorted) const {
    const double s = distorted.squaredNorm(), root = 1 - (2 * alpha - 1) * s;
    if (!std::isfinite(s) || !(distorted.norm() <= max_plane_radius()) || !(root >= 0))
      return std::nullopt;
    const double m = (1 - alpha * alpha * s) / (alpha * std::sqrt(root) + 1 - alpha),
                 inner = m * m + (1 - xi * xi) * s;
    if (!(inner >= 0)) return std::nullopt;
    const double f = (m * xi + std::sqrt(inner)) / (m * m + s);
    return Eigen::Vector3d(f * distorted.x(), f * distorted.y(), f * m - xi);
  }

 private:
  static double edge_of(double xi, double alpha) {
    const double w1 = std::min(alpha, 1 - alpha) / std::max(alpha, 1 - alpha);
    const double rest = 1 - w1 * w1;
    return xi * rest + w1 * std::sqrt(1 - xi * xi * rest);
  }
};

}  // namespace redrive
