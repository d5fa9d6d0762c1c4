// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/brown_conrady.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "redrive/camera/invert_on_disc.h"
#include "redrive/camera/roots.h"

namespace redrive {
namespace {

/// Radii above this are less than 1e-6 rad from 90 degrees, beyond any image.
constexpr double kFarRadius = 1e6;

/// Returns r in [0, max_radius] with r g(r^2) = distorted_radius, or about the edge if there is
/// none.
double undistorted_radius(const BrownConrady& lens, double distorted_radius) {
  const auto distorted = [&](double r) {
    const double s = r * r;
    return r * (1 + s * (lens.k1 + s * (lens.k2 + s * lens.k3)));
  };
  const auto slope = [&](double r) {
    const double s = r * r;
    return 1 + s * (3 * lens.k1 + s * (5 * lens.k2 + s * 7 * lens.k3));
  };
  return increasing_root(distorted, slope, distorted_radius, distorted_radius,
                         std::min(lens.max_radius, kFarRadius));
}

}  // namespace

BrownConrady::BrownConrady(std::span<const double, 5> c)
    : k1(c[0]), k2(c[1]), p1(c[2]), p2(c[3]), k3(c[4]) {
  const double p = std::hypot(p1, p2);
  const std::vector<double> folds =
      sign_changes({1, -20.0 / 3 * p, 3 * k1, 0, 5 * k2, 0, 7 * k3}, kFarRadius);
  if (!folds.empty()) max_radius = folds.front();
}

double BrownConrady::covered_radius() const {
  if (!std::isfinite(max_radius)) return max_radius;
  const double r = max_radius, s = r * r;
  return r * (1 + s * (k1 + s * (k2 + s * k3))) - 6 * std::hypot(p1, p2) * s;
}

std::optional<Eigen::Vector2d> BrownConrady::undistort(const Eigen::Vector2d& distorted) const {
  const double distorted_radius = distorted.norm();
  if (!std::isfinite(distorted_radius)) return std::nullopt;
  if (distorted_radius == 0) return distorted;
  if (std::isfinite(max_radius)) {
    // The image of the disc ends at |x_d| <= r g + 3 |p| r^2.
    const double s = max_radius * max_radius;
    const double reach =
        max_radius * (1 + s * (k1 + s * (k2 + s * k3))) + 3 * std::hypot(p1, p2) * s;
    if (distorted_radius > reach) return std::nullopt;
  }

  const auto jacobian = [&](const Eigen::Vector2d& x) {
    const double s = x.squaredNorm(), a = x.x(), b = x.y();
    const double g = 1 + s * (k1 + s * (k2 + s * k3)), dg = k1 + s * (2 * k2 + s * 3 * k3);
    Eigen::Matrix2d j;
    j(0, 0) = g + 2 * a * a * dg + 2 * p1 * b + 6 * p2 * a;
    j(1, 1) = g + 2 * b * b * dg + 6 * p1 * b + 2 * p2 * a;
    j(0, 1) = j(1, 0) = 2 * a * b * dg + 2 * p1 * a + 2 * p2 * b;
    return j;
  };
  return invert_on_disc(
      [&](const Eigen::Vector2d& x) {
        const std::array<double, 2> d = distort<double>({x.x(), x.y()});
        return Eigen::Vector2d(d[0], d[1]);
      },
      jacobian, distorted,
      distorted * (undistorted_radius(*this, distorted_radius) / distorted_radius), max_radius);
}

}  // namespace redrive
