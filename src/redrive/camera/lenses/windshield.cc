// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/lenses/windshield.h"

#include <algorithm>

#include <Eigen/LU>

namespace redrive {
namespace {

using Math = NumberMath<double>;
constexpr double kMostReach_rad = 88 * std::numbers::pi / 180;

struct BentAngles {
  Eigen::Vector2d angles;
  Eigen::Matrix2d by;  // Jacobian
};
BentAngles bent(const WindshieldGlass& glass, const Eigen::Vector2d& a) {
  const auto h = bivariate<Math, kWindshieldOrderH>(glass.h.data(), a.x(), a.y());
  const auto v = bivariate<Math, kWindshieldOrderV>(glass.v.data(), a.x(), a.y());
  BentAngles out;
  out.angles = {h.value, v.value};
  out.by << h.by_phi, h.by_theta, v.by_phi, v.by_theta;
  return out;
}

/// The square |phi| + |theta| = sum, as points.
std::vector<Eigen::Vector2d> square(double sum) {
  constexpr int kSteps = 32;
  std::vector<Eigen::Vector2d> points;
  for (int k = 0; k < kSteps; ++k) {
    const double t = sum * k / kSteps;
    points.insert(points.end(), {{sum - t, t}, {-t, sum - t}, {t - sum, -t}, {t, t - sum}});
  }
  return points;
}

/// Angle from the axis behind the glass; beyond 90 degrees: pi.
double angle_behind(const Eigen::Vector2d& bent_angles) {
  if (!(bent_angles.cwiseAbs().sum() < 0.995 * std::numbers::pi / 2)) return std::numbers::pi;
  return std::asin(std::hypot(std::sin(bent_angles.x()), std::sin(bent_angles.y())));
}

/// Whether the glass is one-to-one about a point, with room for what lies between points.
bool is_regular(const BentAngles& at) {
  constexpr double kLeastSlope = 0.2;
  const double cross = at.by(0, 1) + at.by(1, 0);
  return at.by(0, 0) > kLeastSlope && at.by(1, 1) > kLeastSlope &&
         cross * cross < 3.5 * at.by(0, 0) * at.by(1, 1) &&
         angle_behind(at.angles) < std::numbers::pi;
}

}  // namespace

WindshieldGlass::WindshieldGlass(std::span<const double> c) {
  std::copy_n(c.begin(), h.size(), h.begin());
  std::copy_n(c.begin() + kWindshieldTermsH, v.size(), v.begin());
  constexpr int kSteps = 88;
  for (int k = 0; k <= kSteps; ++k) {
    const double sum = kMostReach_rad * k / kSteps;
    if (!std::ranges::all_of(square(sum),
                             [&](const auto& a) { return is_regular(bent(*this, a)); }))
      break;
    reach_rad = sum;
  }
  if (!before(Eigen::Vector3d::UnitZ())) return;
  // The square's edge, bent, encloses the directions that come from within the reach.
  covered_rad = std::numbers::pi;
  for (const Eigen::Vector2d& edge : square(reach_rad))
    covered_rad = std::min(covered_rad, 0.999 * angle_behind(bend(edge)));
}

Eigen::Vector2d WindshieldGlass::bend(const Eigen::Vector2d& angles) const {
  return bent(*this, angles).angles;
}

std::optional<Eigen::Vector3d> WindshieldGlass::before(const Eigen::Vector3d& behind) const {
  if (!(behind.z() > 0)) return std::nullopt;
  const Eigen::Vector2d target(std::asin(behind.x()), std::asin(behind.y()));
  Eigen::Vector2d a = target;
  constexpr int kMostSteps = 50;
  double moved = 1;
  for (int i = 0; i < kMostSteps && moved > 1e-15; ++i) {
    const BentAngles at = bent(*this, a);
    Eigen::Vector2d step = at.by.inverse() * (target - at.angles);
    step = step.cwiseMax(-0.2).cwiseMin(0.2);
    a = (a + step).cwiseMax(-kMostReach_rad).cwiseMin(kMostReach_rad);
    moved = step.norm();
  }
  // The reach is shortened by more than its rounding, so that `project` sees the direction.
  if (!(moved < 1e-12 && a.cwiseAbs().sum() <= reach_rad * (1 - 1e-12))) return std::nullopt;
  const double x = std::sin(a.x()), y = std::sin(a.y());
  return Eigen::Vector3d(x, y, std::sqrt(1 - x * x - y * y));
}

}  // namespace redrive
