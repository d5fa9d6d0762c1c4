// SPDX-License-Identifier: Apache-2.0
#include "redrive/math/dual.h"

#include <functional>
#include <numbers>

#include <gtest/gtest.h>

namespace redrive {
namespace {

using Dual1 = Dual<double, 1>;
using Dual2 = Dual<double, 2>;

struct Case {
  const char* name;
  std::function<Dual1(Dual1)> f;
  double x, value, slope;
};

// A handful of roundings of numbers of order 1..10 each.
constexpr double kRounding = 1e-14;

TEST(Dual, DerivativesOfElementaryFunctions) {
  const double pi = std::numbers::pi;
  const Case cases[] = {
      {"sqrt", [](Dual1 x) { return sqrt(x); }, 4, 2, 0.25},
      {"exp", [](Dual1 x) { return exp(x); }, 1, std::numbers::e, std::numbers::e},
      {"log", [](Dual1 x) { return log(x); }, 2, std::numbers::ln2, 0.5},
      {"sin", [](Dual1 x) { return sin(x); }, pi / 6, 0.5, std::sqrt(3.0) / 2},
      {"cos", [](Dual1 x) { return cos(x); }, pi / 6, std::sqrt(3.0) / 2, -0.5},
      {"tan", [](Dual1 x) { return tan(x); }, pi / 4, 1, 2},
      {"atan", [](Dual1 x) { return atan(x); }, 1, pi / 4, 0.5},
      {"pow constant", [](Dual1 x) { return pow(x, 3); }, -2, -8, 12},
      {"pow of exponent", [](Dual1 x) { return pow(Dual1(2), x); }, 3, 8, 8 * std::numbers::ln2},
      {"abs", [](Dual1 x) { return abs(x); }, -3, 3, -1},
      {"polynomial", [](Dual1 x) { return 1 + 2 * x - x * x / 4.0; }, 2, 4, 1},
      {"quotient", [](Dual1 x) { return (x - 1) / (x + 1); }, 3, 0.5, 0.125},
      {"negation", [](Dual1 x) { return -x; }, 3, -3, -1},
  };
  for (const Case& c : cases) {
    const Dual1 y = c.f(Dual1::variable(c.x, 0));
    EXPECT_NEAR(y.value, c.value, kRounding * std::abs(c.value)) << c.name;
    EXPECT_NEAR(y.d[0], c.slope, kRounding * std::abs(c.slope)) << c.name;
  }
}

TEST(Dual, PartialDerivatives) {
  const Dual2 x = Dual2::variable(3, 0), y = Dual2::variable(4, 1);
  const Dual2 angle = atan2(y, x);  // d = (-y, x) / 25
  EXPECT_NEAR(angle.value, std::atan2(4, 3), kRounding);
  EXPECT_NEAR(angle.d[0], -0.16, kRounding);
  EXPECT_NEAR(angle.d[1], 0.12, kRounding);
  const Dual2 product = x * y;
  EXPECT_EQ(product.d[0], 4);
  EXPECT_EQ(product.d[1], 3);
}

TEST(Dual, ConstantHasNoDerivativeEvenAtInfiniteSlope) {
  EXPECT_EQ(sqrt(Dual1(0)).d[0], 0);
  EXPECT_EQ(pow(Dual1(0), 0.5).d[0], 0);
  EXPECT_TRUE(std::isinf(sqrt(Dual1::variable(0, 0)).d[0]));
}

TEST(Dual, ComparesByValue) {
  EXPECT_LT(Dual1::variable(1, 0), Dual1(2));
  EXPECT_TRUE(Dual1::variable(2, 0) == Dual1(2));
  EXPECT_GT(Dual1(2), 1.0);
}

TEST(Dual, WorksInTemplates) {
  const auto norm = []<class T>(T x, T y) {
    using std::sqrt;
    return sqrt(x * x + y * y);
  };
  EXPECT_EQ(norm(3.0, 4.0), 5.0);
  const Dual2 n = norm(Dual2::variable(3, 0), Dual2::variable(4, 1));
  EXPECT_NEAR(n.d[0], 0.6, kRounding);
  EXPECT_NEAR(n.d[1], 0.8, kRounding);
}

}  // namespace
}  // namespace redrive
