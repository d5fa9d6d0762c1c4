// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/lenses/brown_conrady.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "redrive/camera/lenses/invert_on_disc.h"
#include "redrive/camera/lenses/roots.h"

namespace redrive {
namespace {

/// Radii above this are less than 1e-6 rad from 90 degrees, beyond any image.
constexpr double kFarRadius = 1e6;

}  // namespace

BrownConrady::BrownConrady(std::span<const double, 5> c)
    : BrownConradyNumbers<double>{c[0], c[1], c[2], c[3], c[4]} {
  const double p = std::hypot(p1, p2);
  const std::vector<double> folds =
      sign_changes({1, -20.0 / 3 * p, 3 * k1, 0, 5 * k2, 0, 7 * k3}, kFarRadius);
  if (!folds.empty()) max_radius = folds.front();
}

double BrownConrady::covered_radius() const {
  if (!std::isfinite(max_radius)) return max_radius;
  const double r = max_radius, s = r * r;
  return r * radial_factor<NumberMath<double>>(*this, s).value - 6 * std::hypot(p1, p2) * s;
}

std::optional<Eigen::Vector2d> BrownConrady::undistort(const Eigen::Vector2d& distorted) const {
  const double distorted_radius = distorted.norm();
  if (!std::isfinite(distorted_radius)) return std::nullopt;
  if (std::isfinite(max_radius)) {
    // The image of the disc ends at |x_d| <= r g + 3 |p| r^2.
    const double s = max_radius * max_radius;
    const double reach =
        max_radius * radial_factor<NumberMath<double>>(*this, s).value + 3 * std::hypot(p1, p2) * s;
    if (distorted_radius > reach) return std::nullopt;
  }

  return invert_on_disc<BrownConrady>(*this, distorted, std::min(max_radius, kFarRadius));
}

}  // namespace redrive
