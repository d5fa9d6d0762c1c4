// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/lenses/opencv_thin_prism.h"

#include <algorithm>
#include <cmath>

#include "redrive/camera/lenses/invert_on_disc.h"

namespace redrive {

OpenCvThinPrism::OpenCvThinPrism(std::span<const double> c)
    : Numbers<double>{c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8], c[9], c[10], c[11]} {
  max_radius = rational_radius({k1, k2, p1, p2, k3, k4, k5, k6},
                               20.0 / 3 * std::hypot(p1, p2) + 2 * std::hypot(sx1, sy1),
                               8 / std::sqrt(3.0) * std::hypot(sx2, sy2));
}

double OpenCvThinPrism::covered_radius() const {
  if (!std::isfinite(max_radius)) return max_radius;
  const double s = max_radius * max_radius;
  return max_radius * Radial::radial_factor<NumberMath<double>>(*this, s).value -
         (3 * std::hypot(p1, p2) + std::hypot(sx1, sy1) + std::hypot(sx2, sy2) * s) * s;
}

std::optional<Eigen::Vector3d> OpenCvThinPrism::unproject(const Eigen::Vector2d& distorted) const {
  return unproject_pinhole<Radial>(numbers(), distorted,
                                   std::min(max_radius, kFarthestPinholeRadius));
}

}  // namespace redrive
