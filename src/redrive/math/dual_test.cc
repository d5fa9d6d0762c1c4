// SPDX-License-Identifier: Apache-2.0
#include "redrive/math/dual.h"

#include <cmath>

#include <ceres/jet.h>
#include <gtest/gtest.h>

namespace redrive {
namespace {

using Jet3 = ceres::Jet<double, 3>;

/// A quotient, a root and an angle of three variables.
template <class T>
T of_all_operations(const T& x, const T& y, const T& z) {
  using std::atan2;
  using std::sqrt;
  return atan2(sqrt(x * x + y * y), z) * (x / (z + T(2) * y) - y);
}

TEST(Dual, AgreesWithJets) {
  const double points[][3] = {{3, 4, 12}, {-1, 0.5, 2}, {0.25, -3, 1}, {1e-3, 2, -5}};
  for (const auto& p : points) {
    const Dual dual = of_all_operations(Dual(p[0], 0), Dual(p[1], 1), Dual(p[2], 2));
    const Jet3 jet = of_all_operations(Jet3(p[0], 0), Jet3(p[1], 1), Jet3(p[2], 2));
    // Two dozen roundings of numbers of at most twice the largest derivative.
    const double tolerance = 48 * 0x1p-53 * (std::abs(jet.a) + jet.v.cwiseAbs().maxCoeff());
    EXPECT_NEAR(dual.value, jet.a, tolerance);
    for (int i = 0; i < 3; ++i) EXPECT_NEAR(dual.d[i], jet.v[i], tolerance) << i;
  }
}

TEST(Dual, ValueIsThatOfThePlainNumber) {
  EXPECT_EQ(of_all_operations(Dual(3, 0), Dual(7, 1), Dual(49, 2)).value,
            of_all_operations(3.0, 7.0, 49.0));
}

TEST(Dual, ConstantHasNoDerivativeEvenAtInfiniteSlope) {
  EXPECT_EQ(sqrt(Dual(0)).d[0], 0);
  EXPECT_TRUE(std::isinf(sqrt(Dual(0, 0)).d[0]));
}

TEST(Dual, ComparesByValue) {
  EXPECT_TRUE(Dual(1, 0) < Dual(2));
  EXPECT_TRUE(Dual(2) <= Dual(2, 1));
  EXPECT_FALSE(Dual(std::nan("")) > Dual(0));
}

}  // namespace
}  // namespace redrive
