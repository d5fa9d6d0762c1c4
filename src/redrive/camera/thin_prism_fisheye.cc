// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/thin_prism_fisheye.h"

#include <vector>

#include "redrive/camera/invert_on_disc.h"
#include "redrive/camera/roots.h"

namespace redrive {

ThinPrismFisheye::ThinPrismFisheye(std::span<const double> c)
    : k1(c[0]), k2(c[1]), p1(c[2]), p2(c[3]), k3(c[4]), k4(c[5]), sx1(c[6]), sy1(c[7]) {
  const double least = 12 * std::hypot(p1, p2) + 4 * std::hypot(sx1, sy1);
  const std::vector<double> folds =
      sign_changes({1, -least, 3 * k1, 0, 5 * k2, 0, 7 * k3, 0, 9 * k4}, max_angle_rad);
  if (!folds.empty()) max_angle_rad = folds.front();
}

double ThinPrismFisheye::covered_radius() const {
  const double s = max_angle_rad * max_angle_rad;
  return max_angle_rad * radial_factor(s) - (6 * std::hypot(p1, p2) + std::hypot(sx1, sy1)) * s;
}

std::optional<Eigen::Vector3d> ThinPrismFisheye::unproject(const Eigen::Vector2d& distorted) const {
  const double length = distorted.norm();
  if (!std::isfinite(length)) return std::nullopt;
  if (length == 0) return Eigen::Vector3d(0, 0, 1);
  const auto radius = [&](double a) { return a * radial_factor(a * a); };
  const auto slope = [&](double a) {
    const double s = a * a;
    return 1 + s * (3 * k1 + s * (5 * k2 + s * (7 * k3 + s * 9 * k4)));
  };
  const double start = increasing_root(radius, slope, length, length, max_angle_rad);
  const auto m = invert_on_disc(*this, distorted, distorted * (start / length), max_angle_rad);
  if (!m) return std::nullopt;
  const double angle = m->norm();
  const Eigen::Vector2d sideways = *m * (std::sin(angle) / angle);
  return Eigen::Vector3d(sideways.x(), sideways.y(), std::cos(angle));
}

}  // namespace redrive
