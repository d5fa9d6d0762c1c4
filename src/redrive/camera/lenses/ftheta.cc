// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/lenses/ftheta.h"

#include <algorithm>
#include <vector>

#include <Eigen/SVD>

#include "redrive/camera/lenses/lens.h"
#include "redrive/camera/lenses/roots.h"

namespace redrive {
namespace {

using Math = NumberMath<double>;
}  // namespace

FThetaLens::FThetaLens(std::span<const double> c)
    : Numbers<double>{c[0], c[1], c[2], c[3], c[4], c[5], 0},
      max_angle_rad(std::min(c[6], std::numbers::pi * (1 - 1e-9))) {}

double FThetaLens::increases_to(double end) const {
  const std::vector<double> folds =
      sign_changes({1 - kLeastSlope, 2 * k2, 3 * k3, 4 * k4, 5 * k5}, end);
  return folds.empty() ? end : folds.front();
}

double FThetaLens::covered_radius() const { return least_sheared(max_radius); }

// Its least singular value.
double FThetaLens::least_sheared(double length) const {
  Eigen::Matrix2d shear;
  shear << 1, shear_x, shear_y, 1;
  return length * shear.jacobiSvd().singularValues().minCoeff();
}

FTheta::FTheta(std::span<const double> c) : FThetaLens(c) {
  max_angle_rad = increases_to(max_angle_rad);
  max_radius = polynomial<Math>(numbers(), max_angle_rad).value;
}

std::optional<Eigen::Vector3d> FTheta::unproject(const Eigen::Vector2d& distorted) const {
  return direction(distorted, [&](double r) {
    return increasing_root([&](double a) { return polynomial<Math>(numbers(), a).value; },
                           [&](double a) { return polynomial<Math>(numbers(), a).slope; }, r, r,
                           max_angle_rad);
  });
}

FThetaInverse::FThetaInverse(std::span<const double> c) : FThetaLens(c) {
  const auto angle = [&](double r) { return polynomial<Math>(numbers(), r).value; };
  const double end = increases_to(4 * max_angle_rad);
  max_angle_rad = std::min(max_angle_rad, angle(end));
  max_radius = increasing_root(
      angle, [&](double r) { return polynomial<Math>(numbers(), r).slope; }, max_angle_rad,
      max_angle_rad, end);
}

std::optional<Eigen::Vector3d> FThetaInverse::unproject(const Eigen::Vector2d& distorted) const {
  return direction(distorted, [&](double r) {
    return std::min(polynomial<Math>(numbers(), r).value, max_angle_rad);
  });
}

}  // namespace redrive
