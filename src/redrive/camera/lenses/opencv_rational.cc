// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/lenses/opencv_rational.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "redrive/camera/lenses/invert_on_disc.h"
#include "redrive/camera/lenses/roots.h"

namespace redrive {
namespace {

std::vector<double> product(const std::vector<double>& a, const std::vector<double>& b) {
  std::vector<double> out(a.size() + b.size() - 1);
  for (std::size_t i = 0; i < a.size(); ++i)
    for (std::size_t j = 0; j < b.size(); ++j) out[i + j] += a[i] * b[j];
  return out;
}

/// r times the derivative: sum of i c_i r^i.
std::vector<double> times_derivative(std::vector<double> polynomial) {
  for (std::size_t i = 0; i < polynomial.size(); ++i) polynomial[i] *= static_cast<double>(i);
  return polynomial;
}

}  // namespace

// With g = n / d, the derivative of r g is (n d + r n' d - r n d') / d^2. The bound, times d^2, is
// a polynomial.
double rational_radius(const RationalNumbers<double>& c, double linear, double cubic) {
  const std::vector<double> n = {1, 0, c.k1, 0, c.k2, 0, c.k3}, d = {1, 0, c.k4, 0, c.k5, 0, c.k6};
  const std::vector<double> nd = product(n, d), n_slope = product(times_derivative(n), d),
                            d_slope = product(n, times_derivative(d)),
                            least = product({0, linear, 0, cubic}, product(d, d));
  std::vector<double> above(least.size());
  for (std::size_t i = 0; i < above.size(); ++i)
    above[i] = (i < nd.size() ? nd[i] + n_slope[i] - d_slope[i] : 0) - least[i];
  double radius = std::numeric_limits<double>::infinity();
  for (const std::vector<double>& polynomial : {above, d})
    if (const std::vector<double> edges = sign_changes(polynomial, kFarthestPinholeRadius);
        !edges.empty())
      radius = std::min(radius, (1 - 1e-9) * edges.front());
  return radius;
}

// The bound of camera/lenses/brown_conrady.h.
OpenCvRational::OpenCvRational(std::span<const double> c)
    : Numbers<double>{c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7]},
      max_radius(rational_radius(*this, 20.0 / 3 * std::hypot(p1, p2), 0)) {}

double OpenCvRational::covered_radius() const {
  if (!std::isfinite(max_radius)) return max_radius;
  const double s = max_radius * max_radius;
  return max_radius * radial_factor<NumberMath<double>>(*this, s).value -
         6 * std::hypot(p1, p2) * s;
}

std::optional<Eigen::Vector3d> OpenCvRational::unproject(const Eigen::Vector2d& distorted) const {
  return unproject_pinhole<Radial>(numbers(), distorted,
                                   std::min(max_radius, kFarthestPinholeRadius));
}

}  // namespace redrive
