// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/lenses/brown_conrady.h"

#include <cmath>
#include <numbers>

#include <ceres/jet.h>
#include <gtest/gtest.h>

namespace redrive {
namespace {

BrownConrady lens(const std::array<double, 5>& coefficients) { return BrownConrady(coefficients); }

TEST(BrownConrady, FoldRadiusIsTheFirstRootOfTheDerivative) {
  EXPECT_TRUE(std::isinf(lens({0, 0, 0, 0, 0}).max_radius));
  EXPECT_TRUE(std::isinf(lens({0.3, 0.1, 0, 0, 0.01}).max_radius));
  // 1 + 3 k1 s + 5 k2 s^2 has no real root: 9 k1^2 < 20 k2.
  EXPECT_TRUE(std::isinf(lens({-0.3, 0.08, 0, 0, 0}).max_radius));
  EXPECT_NEAR(lens({-0.4, 0, 0, 0, 0}).max_radius, std::sqrt(1 / 1.2), 1e-14);
  // 9 k1^2 > 20 k2: two roots, s = (-3 k1 -+ sqrt(9 k1^2 - 20 k2)) / (10 k2), of which the smaller
  // counts.
  const double near_root = (1.2 - std::sqrt(1.44 - 20 * 0.06)) / 0.6;
  EXPECT_NEAR(lens({-0.4, 0.06, 0, 0, 0}).max_radius, std::sqrt(near_root), 1e-13);
  EXPECT_NEAR(lens({0, 0, 0, 0, -1.0 / 7}).max_radius, 1, 1e-14);  // 1 - s^3
}

TEST(BrownConrady, TangentialTermsShrinkTheValidRegion) {
  const std::array<double, 5> coefficients{-0.4, 0.01, 0.004, -0.003, 0};
  const BrownConrady lens(coefficients);
  ASSERT_TRUE(std::isfinite(lens.max_radius));
  const auto smallest_determinant = [&](double r) {
    double smallest = 1e300;
    for (int i = 0; i < 3600; ++i) {
      using Jet = ceres::Jet<double, 2>;
      const double angle = i * std::numbers::pi / 1800;
      using M = NumberMath<Jet>;
      const Jet x(r * std::cos(angle), 0), y(r * std::sin(angle), 1);
      const LensPoint<M> d =
          distort<BrownConrady, M>(lens, Jet(1e9), PlanePoint<M>{x, y, x * x + y * y, true});
      smallest = std::min(smallest, d.x.v[0] * d.y.v[1] - d.x.v[1] * d.y.v[0]);
    }
    return smallest;
  };
  for (int i = 0; i <= 100; ++i) EXPECT_GT(smallest_determinant(lens.max_radius * i / 100), 0) << i;
  // The bound is tight: the radial derivative falls with slope 6 k1 r = -2 there, and the bound is
  // loose by 2/3 |p| r.
  EXPECT_LT(smallest_determinant(lens.max_radius * 1.01), 0);
}

}  // namespace
}  // namespace redrive
