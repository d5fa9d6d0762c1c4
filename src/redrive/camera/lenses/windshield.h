// SPDX-License-Identifier: Apache-2.0
// "ftheta_windshield" and "ftheta_inverse_windshield": a lens of camera/lenses/ftheta.h behind a
// windshield, NCore's "bivariate-windshield". With (X, Y, Z) of length 1, phi = asin X and
// theta = asin Y, the lens sees the direction (sin phi', sin theta', +-sqrt(1 - sin^2 phi' -
// sin^2 theta')), whose last number has the sign of Z, for
//   phi'   = sum over i + j <= 2 of h_ij phi^i theta^j,
//   theta' = sum over i + j <= 4 of v_ij phi^i theta^j.
// Directions are unit vectors with Z > 0, where |phi| + |theta| < 90 degrees. This square is
// convex: the glass is one-to-one up to `reach`, the |phi| + |theta| within which the symmetric
// part of the Jacobian is positive definite.
#pragma once

#include <array>
#include <cmath>
#include <numbers>
#include <optional>
#include <span>
#include <type_traits>

#include <Eigen/Core>

#include "redrive/camera/calibration.h"
#include "redrive/camera/lenses/ftheta.h"

namespace redrive {

/// Terms of a polynomial of phi and theta with i + j <= order, in the order of NCore: theta^0
/// phi^0, theta^0 phi^1, ..., theta^1 phi^0, ...
constexpr int windshield_terms(int order) { return (order + 1) * (order + 2) / 2; }
constexpr int kWindshieldOrderH = 2, kWindshieldOrderV = 4;
constexpr int kWindshieldTermsH = windshield_terms(kWindshieldOrderH),
              kWindshieldTermsV = windshield_terms(kWindshieldOrderV);

/// Coefficients in any precision (camera/lenses/lens.h).
template <class S>
struct WindshieldNumbers : FThetaNumbers<S> {
  S h[kWindshieldTermsH], v[kWindshieldTermsV];
  S reach;  ///< rad
};

template <class M>
struct BivariateValue {
  typename M::Real value, by_phi, by_theta;
};
/// The polynomial of that order and its derivatives, by Horner's rule.
template <class M, int kOrder, class S>
REDRIVE_LANES BivariateValue<M> bivariate(const S* c, typename M::Real phi,
                                          typename M::Real theta) {
  using Real = typename M::Real;
  BivariateValue<M> sum{M::constant(0), M::constant(0), M::constant(0)};
  int first = windshield_terms(kOrder);
  for (int j = kOrder; j >= 0; --j) {
    const int n = kOrder - j + 1;
    first -= n;
    Real row = M::constant(c[first + n - 1]), slope = M::constant(0);
    for (int i = n - 2; i >= 0; --i) {
      slope = row + phi * slope;
      row = M::constant(c[first + i]) + phi * row;
    }
    sum.by_theta = sum.value + theta * sum.by_theta;
    sum.value = row + theta * sum.value;
    sum.by_phi = slope + theta * sum.by_phi;
  }
  return sum;
}

/// EquidistantPlane behind the glass.
struct WindshieldPlane {
  template <class M, class S>
  static REDRIVE_LANES PlanePoint<M> project(const WindshieldNumbers<S>& c, typename M::Real x,
                                             typename M::Real y, typename M::Real z) {
    const Bent<M> b = bend<M>(c, x, y, z);
    PlanePoint<M> p = EquidistantPlane::project<M>(c, b.x, b.y, b.z);
    p.seen = M::both(p.seen, b.seen);
    return p;
  }
  template <class M, class S>
  static REDRIVE_LANES void adjoint(const WindshieldNumbers<S>& c, typename M::Real x,
                                    typename M::Real y, typename M::Real z, const PlanePoint<M>& p,
                                    typename M::Real d_x, typename M::Real d_y,
                                    typename M::Real* d_point) {
    using Real = typename M::Real;
    const Real zero = M::constant(0);
    const Bent<M> b = bend<M>(c, x, y, z);
    Real d_bent[3] = {zero, zero, zero};
    EquidistantPlane::adjoint<M>(c, b.x, b.y, b.z, p, d_x, d_y, d_bent);
    // b.z^2 = 1 - b.x^2 - b.y^2, unless it is held at its least.
    const Real by_z = M::select(b.z_is_least, zero, d_bent[2] / b.z);
    const Real d_h = M::select(b.x_is_most, zero, (d_bent[0] - by_z * b.x) * cosine_of<M>(b.x)),
               d_v = M::select(b.y_is_most, zero, (d_bent[1] - by_z * b.y) * cosine_of<M>(b.y));
    const Real d_phi = d_h * b.h.by_phi + d_v * b.v.by_phi,
               d_theta = d_h * b.h.by_theta + d_v * b.v.by_theta;
    const Real d_ux = d_phi / cosine_of<M>(b.ux), d_uy = d_theta / cosine_of<M>(b.uy),
               along = d_ux * b.ux + d_uy * b.uy;
    d_point[0] = d_point[0] + b.per_length * (d_ux - along * b.ux);
    d_point[1] = d_point[1] + b.per_length * (d_uy - along * b.uy);
    d_point[2] = d_point[2] - b.per_length * along * (z * b.per_length);
  }

 private:
  /// A direction before the glass, (ux, uy, .), and behind it, (x, y, z).
  template <class M>
  struct Bent {
    typename M::Real x, y, z, ux, uy, per_length;
    BivariateValue<M> h, v;
    typename M::Mask seen, x_is_most, y_is_most, z_is_least;
  };
  /// Least z^2 behind the glass, and least cosine: numbers stay finite beyond the valid region.
  static constexpr double kLeast = 1e-4;
  /// Largest |phi'| and |theta'|, below 90 degrees.
  static constexpr double kMostAngle = 1.56;

  /// Returns cos a for sin a = x, at least sqrt(kLeast).
  template <class M>
  static REDRIVE_LANES typename M::Real cosine_of(typename M::Real x) {
    return M::sqrt(M::max(M::constant(1) - x * x, M::constant(kLeast)));
  }
  /// Returns asin x. Lanes have atan2 for y >= 0 alone.
  template <class M>
  static REDRIVE_LANES typename M::Real arcsine(typename M::Real x) {
    const typename M::Real zero = M::constant(0);
    const auto negative = x < zero;
    const typename M::Real size = M::atan2(M::select(negative, zero - x, x), cosine_of<M>(x));
    return M::select(negative, zero - size, size);
  }
  /// Returns sin x, |x| <= kMostAngle, to the rounding of S by its series.
  template <class M, class S>
  static REDRIVE_LANES typename M::Real sine(typename M::Real x) {
    using Real = typename M::Real;
    constexpr int kLast = std::is_same_v<S, double> ? 23 : 11;  // power of the last term
    const Real s = x * x, one = M::constant(1);
    Real sum = one;
    for (int k = kLast; k > 1; k -= 2) sum = one - s * sum * M::constant(1.0 / (k * (k - 1)));
    return x * sum;
  }
  template <class M, class S>
  static REDRIVE_LANES Bent<M> bend(const WindshieldNumbers<S>& c, typename M::Real x,
                                    typename M::Real y, typename M::Real z) {
    using Real = typename M::Real;
    const Real zero = M::constant(0), one = M::constant(1), least = M::constant(kLeast),
               most = M::constant(kMostAngle);
    Bent<M> b;
    b.per_length = one / M::sqrt(x * x + y * y + z * z);
    b.ux = x * b.per_length;
    b.uy = y * b.per_length;
    const Real phi = arcsine<M>(b.ux), theta = arcsine<M>(b.uy);
    b.h = bivariate<M, kWindshieldOrderH>(c.h, phi, theta);
    b.v = bivariate<M, kWindshieldOrderV>(c.v, phi, theta);
    const Real bent_phi = M::max(zero - most, M::min(b.h.value, most)),
               bent_theta = M::max(zero - most, M::min(b.v.value, most));
    b.x_is_most = M::either(b.h.value > most, b.h.value < zero - most);
    b.y_is_most = M::either(b.v.value > most, b.v.value < zero - most);
    b.x = sine<M, S>(bent_phi);
    b.y = sine<M, S>(bent_theta);
    const Real zz = one - b.x * b.x - b.y * b.y, root = M::sqrt(M::max(zz, least));
    b.z_is_least = zz < least;
    b.z = M::select(z > zero, root, zero - root);
    const Real sum = M::max(phi, zero - phi) + M::max(theta, zero - theta);
    b.seen = M::both(M::both(z > zero, sum <= M::constant(c.reach)), zz > least);
    return b;
  }
};

/// The polynomials of a glass, which map directions before it to directions behind it.
struct WindshieldGlass {
  std::array<double, kWindshieldTermsH> h{};
  std::array<double, kWindshieldTermsV> v{};
  /// Largest |phi| + |theta| in radians up to which the glass is one-to-one, at most 88 degrees.
  double reach_rad = 0;
  /// Every direction behind the glass within this angle from the axis comes from within the reach.
  double covered_rad = 0;

  WindshieldGlass() = default;
  /// 6 coefficients h, then 15 v, all finite; sets reach_rad and covered_rad.
  explicit WindshieldGlass(std::span<const double> c);

  /// Returns (phi', theta') of (phi, theta).
  Eigen::Vector2d bend(const Eigen::Vector2d& angles) const;
  /// Returns the unit direction before the glass of one behind it, or nothing outside the reach.
  std::optional<Eigen::Vector3d> before(const Eigen::Vector3d& behind) const;
};

/// Lens: FTheta or FThetaInverse.
template <class Lens>
struct Windshield : Lens {
  static constexpr const char* kName =
      std::is_same_v<Lens, FTheta> ? "ftheta_windshield" : "ftheta_inverse_windshield";
  static constexpr std::array<CameraParameter, 25> kDistortion{
      {{"k2"},   {"k3"},   {"k4"},   {"k5"},   {"h_00"}, {"h_10"}, {"h_20"}, {"h_01"}, {"h_11"},
       {"h_02"}, {"v_00"}, {"v_10"}, {"v_20"}, {"v_30"}, {"v_40"}, {"v_01"}, {"v_11"}, {"v_21"},
       {"v_31"}, {"v_02"}, {"v_12"}, {"v_22"}, {"v_03"}, {"v_13"}, {"v_04"}}};
  static constexpr std::array<double, 28> kTypical = [] {
    std::array<double, 28> all{};
    for (int k = 0; k < 4; ++k) all[k] = Lens::kTypical[k];
    constexpr double kGlass[] = {-5e-4, 1,     2e-4,  2e-4, 5e-3,  9e-4,  1e-3,
                                 -5e-4, -6e-5, 0,     6e-4, 1.009, -1e-3, 8e-3,
                                 -3e-4, 0.02,  -3e-3, 6e-3, 0.017, -4e-3, 7e-3};
    for (int k = 0; k < 21; ++k) all[4 + k] = kGlass[k];
    for (int k = 4; k < 7; ++k) all[21 + k] = Lens::kTypical[k];
    return all;
  }();

  using Plane = WindshieldPlane;
  using Radial = Lens;
  template <class S>
  using Numbers = WindshieldNumbers<S>;

  WindshieldGlass glass;

  Windshield() = default;
  /// k2 k3 k4 k5, 6 coefficients h, 15 v, shear_x shear_y max_angle, all finite.
  explicit Windshield(std::span<const double> c)
      : Lens(std::array{c[0], c[1], c[2], c[3], c[25], c[26], c[27]}), glass(c.subspan(4, 21)) {}

  Numbers<double> numbers() const {
    Numbers<double> all{Lens::numbers(), {}, {}, glass.reach_rad};
    std::ranges::copy(glass.h, all.h);
    std::ranges::copy(glass.v, all.v);
    return all;
  }
  double covered_radius() const {
    if (glass.covered_rad >= this->max_angle_rad) return Lens::covered_radius();
    const double s = glass.covered_rad * glass.covered_rad;
    return this->least_sheared(glass.covered_rad *
                               Lens::template radial_factor<NumberMath<double>>(*this, s).value);
  }

  /// Returns the distorted normalised coordinates of a point (any length > 0), or nothing beyond
  /// the reach of the glass or max_angle_rad.
  template <class T>
  std::optional<std::array<T, 2>> project(const std::array<T, 3>& point) const {
    return project_point(*this, point);
  }
  /// Returns the unit direction that is projected to `distorted`, or nothing.
  std::optional<Eigen::Vector3d> unproject(const Eigen::Vector2d& distorted) const {
    const std::optional<Eigen::Vector3d> behind = Lens::unproject(distorted);
    return behind ? glass.before(*behind) : std::nullopt;
  }
};

}  // namespace redrive
