// SPDX-License-Identifier: Apache-2.0
// "mei", for fisheyes: the unified model of Mei and Rives (ICRA 2007, section II), as in OpenCV's
// omnidir.
//   (X, Y, Z)/|.| -> (x, y) = (X/(Z + xi), Y/(Z + xi)) on the unit sphere, then
//   camera/lenses/brown_conrady.h.
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
#include <type_traits>

#include <Eigen/Core>

#include "redrive/camera/calibration.h"
#include "redrive/camera/lenses/brown_conrady.h"

namespace redrive {

/// Coefficients in any precision (camera/lenses/lens.h).
template <class S>
struct MeiNumbers : BrownConradyNumbers<S> {
  S xi;
};

/// (x, y) = (X, Y) / w with w = Z + xi |point|.
struct SpherePlane {
  /// Least w, in lengths of the point, that floats are divided by, so that sigma points near the
  /// sphere's edge (w = 0) stay finite; a point with less is not seen. Doubles reach the edge.
  template <class S>
  static constexpr S least_w() {
    return std::is_same_v<S, float> ? 0.02f : 0;
  }

  template <class M, class S>
  static REDRIVE_LANES PlanePoint<M> project(const MeiNumbers<S>& c, typename M::Real x,
                                             typename M::Real y, typename M::Real z) {
    using Real = typename M::Real;
    PlanePoint<M> p;
    p.length = M::sqrt(x * x + y * y + z * z);
    const Real xi = M::constant(c.xi), w = z + xi * p.length,
               least = M::constant(least_w<S>()) * p.length;
    p.scale = M::constant(1) / M::max(w, least);
    p.x = x * p.scale;
    p.y = y * p.scale;
    p.s = p.x * p.x + p.y * p.y;
    // Directions further back than the edge: w = 0, or cos a = -1/xi where the lift has no root.
    p.seen = M::both(w > least, p.length + xi * z > M::constant(0));
    return p;
  }
  template <class M, class S>
  static REDRIVE_LANES void adjoint(const MeiNumbers<S>& c, typename M::Real x, typename M::Real y,
                                    typename M::Real z, const PlanePoint<M>& p,
                                    typename M::Real d_x, typename M::Real d_y,
                                    typename M::Real* d_point) {
    using Real = typename M::Real;
    const Real xi = M::constant(c.xi), least = M::constant(least_w<S>()), zero = M::constant(0);
    const auto is_least = z + xi * p.length < least * p.length;
    d_x = d_x * p.scale;
    d_y = d_y * p.scale;
    const Real d_w = zero - (d_x * p.x + d_y * p.y),
               by_length = d_w * M::select(is_least, least, xi) / p.length;
    d_point[0] = d_point[0] + d_x + by_length * x;
    d_point[1] = d_point[1] + d_y + by_length * y;
    d_point[2] = d_point[2] + by_length * z + M::select(is_least, zero, d_w);
  }
};

struct Mei {
  static constexpr const char* kName = "mei";
  static constexpr auto kDistortion = BrownConrady::kParameters;
  static constexpr std::array<CameraParameter, 1> kOther{{{"xi", 0, 10}}};
  static constexpr std::array<std::string_view, 0> kTransformsNames{};
  static constexpr bool kPerspective = false, kImageCircle = true;
  static constexpr std::array<double, 6> kTypical{0.03, -0.08, 0, 0, 0, 1.02};

  using Plane = SpherePlane;
  using Radial = BrownConrady;
  template <class S>
  using Numbers = MeiNumbers<S>;

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

  Numbers<double> numbers() const { return {distortion, xi}; }
  double max_plane_radius() const { return distortion.max_radius; }
  double covered_radius() const { return distortion.covered_radius(); }

  /// Returns the distorted normalised coordinates of a point (any length > 0), or nothing beyond
  /// the edge of the sphere or the fold.
  template <class T>
  std::optional<std::array<T, 2>> project(const std::array<T, 3>& point) const {
    return project_point(*this, point);
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
