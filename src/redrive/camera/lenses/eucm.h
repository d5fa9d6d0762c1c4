// SPDX-License-Identifier: Apache-2.0
// "eucm", for fisheyes: the enhanced unified camera model of Khomutenko, Garcia and Martinet (RA-L
// 2016, eq. 9), Kalibr's eucm.
//   (X, Y, Z) -> (X, Y) / (alpha d + (1 - alpha) Z),   d = sqrt(beta (X^2 + Y^2) + Z^2).
// Inverse: with s = x^2 + y^2,
//   Z = (1 - beta alpha^2 s) / (alpha sqrt(1 - (2 alpha - 1) beta s) + 1 - alpha), X = x, Y = y.
// Directions with Z <= -w d have no pixel, w = min(alpha, 1 - alpha) / max(alpha, 1 - alpha).
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
struct EucmNumbers {
  S alpha, beta;
  S edge;  ///< w
};

/// (x, y) = (X, Y) / (alpha d + (1 - alpha) Z).
struct EllipsoidPlane {
  template <class M, class S>
  static REDRIVE_LANES PlanePoint<M> project(const EucmNumbers<S>& c, typename M::Real x,
                                             typename M::Real y, typename M::Real z) {
    using Real = typename M::Real;
    PlanePoint<M> p;
    p.length = M::sqrt(M::constant(c.beta) * (x * x + y * y) + z * z);
    const Real alpha = M::constant(c.alpha), w = alpha * p.length + (M::constant(1) - alpha) * z,
               least = M::constant(SpherePlane::least_w<S>()) * p.length;
    p.scale = M::constant(1) / M::max(w, least);
    p.x = x * p.scale;
    p.y = y * p.scale;
    p.s = p.x * p.x + p.y * p.y;
    p.seen = M::both(w > least, z + M::constant(c.edge) * p.length > M::constant(0));
    return p;
  }
  template <class M, class S>
  static REDRIVE_LANES void adjoint(const EucmNumbers<S>& c, typename M::Real x, typename M::Real y,
                                    typename M::Real z, const PlanePoint<M>& p,
                                    typename M::Real d_x, typename M::Real d_y,
                                    typename M::Real* d_point) {
    using Real = typename M::Real;
    const Real alpha = M::constant(c.alpha), beta = M::constant(c.beta), zero = M::constant(0),
               least = M::constant(SpherePlane::least_w<S>()), rest = M::constant(1) - alpha;
    const auto is_least = alpha * p.length + rest * z < least * p.length;
    d_x = d_x * p.scale;
    d_y = d_y * p.scale;
    const Real d_w = zero - (d_x * p.x + d_y * p.y),
               by_length = d_w * M::select(is_least, least, alpha) / p.length;
    d_point[0] = d_point[0] + d_x + by_length * beta * x;
    d_point[1] = d_point[1] + d_y + by_length * beta * y;
    d_point[2] = d_point[2] + by_length * z + M::select(is_least, zero, d_w * rest);
  }
};

struct Eucm : EucmNumbers<double> {
  static constexpr const char* kName = "eucm";
  static constexpr std::array<CameraParameter, 0> kDistortion{};
  static constexpr std::array<CameraParameter, 2> kOther{{{"alpha", 0, 1}, {"beta", 0.01, 100}}};
  static constexpr std::array<std::string_view, 0> kTransformsNames{};
  static constexpr bool kPerspective = false, kImageCircle = false;
  static constexpr std::array<double, 2> kTypical{0.6, 1.1};

  using Plane = EllipsoidPlane;
  using Radial = NoDistortion;
  template <class S>
  using Numbers = EucmNumbers<S>;

  Eucm() : Numbers<double>{0, 1, 0} {}
  /// alpha beta.
  explicit Eucm(std::span<const double> parameters)
      : Numbers<double>{parameters[0], parameters[1],
                        std::min(parameters[0], 1 - parameters[0]) /
                            std::max(parameters[0], 1 - parameters[0])} {}

  const Numbers<double>& numbers() const { return *this; }
  /// Where the root of the inverse is 0; 1e-9 as Mei has it.
  double max_plane_radius() const {
    return alpha > 0.5 ? (1 - 1e-9) / std::sqrt((2 * alpha - 1) * beta)
                       : std::numeric_limits<double>::infinity();
  }
  double covered_radius() const { return max_plane_radius(); }

  /// Returns the normalised coordinates of a point (any length > 0), or nothing beyond the edge.
  template <class T>
  std::optional<std::array<T, 2>> project(const std::array<T, 3>& point) const {
    return project_point(*this, point);
  }

  /// Returns the direction (not normalised) that is projected to `distorted`, or nothing.
  std::optional<Eigen::Vector3d> unproject(const Eigen::Vector2d& distorted) const {
    const double s = distorted.squaredNorm(), root = 1 - (2 * alpha - 1) * beta * s;
    if (!std::isfinite(s) || !(distorted.norm() <= max_plane_radius()) || !(root >= 0))
      return std::nullopt;
    const double z = (1 - beta * alpha * alpha * s) / (alpha * std::sqrt(root) + 1 - alpha);
    return Eigen::Vector3d(distorted.x(), distorted.y(), z);
  }
};

}  // namespace redrive
