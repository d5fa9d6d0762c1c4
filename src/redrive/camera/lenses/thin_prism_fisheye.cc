// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/lenses/thin_prism_fisheye.h"

#include <vector>

#include "redrive/camera/lenses/invert_on_disc.h"
#include "redrive/camera/lenses/roots.h"

namespace redrive {

ThinPrismFisheye::ThinPrismFisheye(std::span<const double> c)
    : Numbers<double>{c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7]} {
  const double least = 20.0 / 3 * std::hypot(p1, p2) + 2 * std::hypot(sx1, sy1);
  const std::vector<double> folds =
      sign_changes({1, -least, 3 * k1, 0, 5 * k2, 0, 7 * k3, 0, 9 * k4}, max_angle_rad);
  if (!folds.empty()) max_angle_rad = folds.front();
}

double ThinPrismFisheye::covered_radius() const {
  const double s = max_angle_rad * max_angle_rad;
  return max_angle_rad * Radial::radial_factor<NumberMath<double>>(*this, s).value -
         (3 * std::hypot(p1, p2) + std::hypot(sx1, sy1)) * s;
}

std::optional<Eigen::Vector3d> ThinPrismFisheye::unproject(const Eigen::Vector2d& distorted) const {
  if (!distorted.allFinite()) return std::nullopt;
  const auto m = invert_on_disc<Radial>(numbers(), distorted, max_angle_rad);
  if (!m) return std::nullopt;
  return EquidistantPlane::unproject(*m);
}

}  // namespace redrive
