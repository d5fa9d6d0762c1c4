// SPDX-License-Identifier: Apache-2.0
#include "redrive/math/plane_fit.h"

#include <vector>

#include <gtest/gtest.h>

#include "redrive/math/so3.h"

namespace redrive {
namespace {

/// Corners of a box of the half sides a < b < c around `centre`, turned. Their variance along each
/// side is its square.
std::vector<Eigen::Vector3d> corners(const Eigen::Vector3d& half, const Eigen::Matrix3d& axes,
                                     const Eigen::Vector3d& centre) {
  std::vector<Eigen::Vector3d> points;
  for (int k = 0; k < 8; ++k)
    points.push_back(centre + axes * half.cwiseProduct(Eigen::Vector3d(
                                         k & 1 ? 1 : -1, k & 2 ? 1 : -1, k & 4 ? 1 : -1)));
  return points;
}

// 5 km from the origin the square of a coordinate has a rounding error of 3e-9 m^2: sums from the
// first point must not have it.
TEST(PlaneFit, FindsTheAxesOfABoxFarFromTheOrigin) {
  const Eigen::Matrix3d axes = so3_exp({0.3, -0.2, 0.9});
  const Eigen::Vector3d half(0.005, 0.4, 1.5), centre(5000, -3000, 20);
  const PlaneFit fit =
      fit_plane(std::vector<int>{0, 1, 2, 3, 4, 5, 6, 7},
                [points = corners(half, axes, centre)](int i) { return points[i]; });
  EXPECT_LT((fit.mean - centre).norm(), 1e-11);
  for (int k = 0; k < 3; ++k) {
    EXPECT_NEAR(std::abs(fit.axes.col(k).dot(axes.col(k))), 1, 1e-10) << k;
    // Coordinates are rounded to 1e-12 m: 1e-12 * 1.5 m at most in a square.
    EXPECT_NEAR(fit.variance[k], half[k] * half[k], 1e-11) << k;
  }
  EXPECT_NEAR(fit.thickness(), 0.005, 1e-9);
  EXPECT_NEAR(std::abs(fit.normal().dot(axes.col(0))), 1, 1e-10);
}

TEST(PlaneFit, TakesFloatsAndGivesAPointNoExtent) {
  PlaneSums sums;
  sums.add(Eigen::Vector3f(1, 2, 3));
  EXPECT_EQ(sums.fit().mean, Eigen::Vector3d(1, 2, 3));
  EXPECT_EQ(sums.fit().variance, Eigen::Vector3d::Zero());
  sums.add(Eigen::Vector3f(1, 2, 5));
  EXPECT_EQ(sums.n(), 2);
  EXPECT_EQ(sums.fit().mean, Eigen::Vector3d(1, 2, 4));
  EXPECT_EQ(sums.fit().extent(), Eigen::Vector3d(0, 0, 1));
}

}  // namespace
}  // namespace redrive
