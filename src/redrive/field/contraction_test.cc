// SPDX-License-Identifier: Apache-2.0
#include "redrive/field/contraction.h"

#include <vector>

#include <ceres/jet.h>
#include <gtest/gtest.h>

#include "redrive/base/rng.h"

namespace redrive {
namespace {

const Contraction kRoad{{3, -1, 0.5f}, 8, true}, kRoom{{3, -1, 0.5f}, 8, false};

double uniform(std::uint64_t stream, std::uint64_t i) {
  return 2.0 * random_unit(random_key(42, kStreamTest, stream), i) - 1;
}

/// The point at u = m times a direction of maximum norm 1.
std::array<double, 3> world_at(const Contraction& contraction, const double direction[3],
                               double m) {
  std::array<double, 3> world;
  for (int k = 0; k < 3; ++k)
    world[k] = contraction.center[k] + contraction.half_m * m * direction[k];
  return world;
}

/// d unit_row / d world_column.
struct Jacobian {
  double unit[3], of[3][3], factor;

  Jacobian(const Contraction& contraction, const std::array<double, 3>& world) {
    using Jet = ceres::Jet<double, 3>;
    const Jet x[3] = {Jet(world[0], 0), Jet(world[1], 1), Jet(world[2], 2)};
    Jet y[3];
    factor = contract(contraction, x, y).a;
    for (int r = 0; r < 3; ++r) {
      unit[r] = y[r].a;
      for (int c = 0; c < 3; ++c) of[r][c] = y[r].v[c];
    }
  }
  double determinant() const {
    return of[0][0] * (of[1][1] * of[2][2] - of[1][2] * of[2][1]) -
           of[0][1] * (of[1][0] * of[2][2] - of[1][2] * of[2][0]) +
           of[0][2] * (of[1][0] * of[2][1] - of[1][1] * of[2][0]);
  }
};

TEST(Contraction, NearRegionIsScaled) {
  for (int i = 0; i < 50; ++i) {
    const double u[3] = {uniform(1, 3 * i), uniform(1, 3 * i + 1), uniform(1, 3 * i + 2)};
    const std::array<double, 3> world = world_at(kRoad, u, 1);
    double unit[3];
    const double factor = contract(kRoad, world.data(), unit);
    for (int k = 0; k < 3; ++k) EXPECT_NEAR(unit[k], (u[k] + 2) / 4, 8 * 0x1p-53);
    EXPECT_EQ(factor, 0.25 / 8);
  }
  // Its corners are the middle half of the cube, exactly.
  const double low[3] = {-5, -9, -7.5}, high[3] = {11, 7, 8.5};
  double unit[3];
  contract(kRoad, low, unit);
  for (const double y : unit) EXPECT_EQ(y, 0.25);
  contract(kRoad, high, unit);
  for (const double y : unit) EXPECT_EQ(y, 0.75);
}

TEST(Contraction, AdjointIsTheJacobianTransposed) {
  for (const Contraction& contraction : {kRoad, kRoom})
    for (int i = 0; i < 60; ++i) {
      const double u[3] = {uniform(5, 3 * i), uniform(5, 3 * i + 1), uniform(5, 3 * i + 2)};
      const std::array<double, 3> world = world_at(contraction, u, i % 2 == 0 ? 1 : 1 + 0.5 * i);
      const Jacobian jacobian(contraction, world);
      const double d_unit[3] = {uniform(6, 3 * i), uniform(6, 3 * i + 1), uniform(6, 3 * i + 2)};
      double d_world[3];
      contract_adjoint(contraction, world.data(), d_unit, d_world);
      for (int c = 0; c < 3; ++c) {
        double expected = 0;
        for (int r = 0; r < 3; ++r) expected += jacobian.of[r][c] * d_unit[r];
        EXPECT_NEAR(d_world[c], expected, 1e-15) << i;
      }
    }
}

TEST(Contraction, InfinityMapsToTheFaces) {
  const double direction[3] = {-0.5, 1, 0.25};
  double before = 0.75;
  for (const double m : {2.0, 10.0, 1e3, 1e6, 1e12}) {
    double unit[3];
    contract(kRoad, world_at(kRoad, direction, m).data(), unit);
    const double y =
        4 * unit[1] - 2;  // along the largest coordinate 2 - 1/m, the others in proportion
    EXPECT_NEAR(y, 2 - 1 / m, 1e-12);
    EXPECT_NEAR(4 * unit[0] - 2, -0.5 * y, 1e-12);
    EXPECT_NEAR(4 * unit[2] - 2, 0.25 * y, 1e-12);
    EXPECT_GT(unit[1], before);
    EXPECT_LE(unit[1], 1);
    before = unit[1];
  }
  const float far[3] = {1e18f, 0, -1e18f};
  float unit[3];
  EXPECT_GE(contract(kRoad, far, unit), 0);
  EXPECT_EQ(unit[0], 1);
  EXPECT_EQ(unit[2], 0);
  EXPECT_NEAR(unit[1], 0.5, 1e-6);
}

TEST(Contraction, IsSmoothWhereTheNearRegionEnds) {
  // Value, derivative along the radius (1/m^2) and across it agree at m = 1, so both sides differ
  // by the distance between them.
  const double direction[3] = {0.75, -1, 0.125}, h = 1e-9;
  const Jacobian inside(kRoad, world_at(kRoad, direction, 1 - h)),
      beyond(kRoad, world_at(kRoad, direction, 1 + h));
  for (int r = 0; r < 3; ++r) {
    EXPECT_NEAR(inside.unit[r], beyond.unit[r], h);
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(inside.of[r][c], beyond.of[r][c], 4 * h);
  }
  EXPECT_NEAR(inside.factor, beyond.factor, h);
  EXPECT_NE(inside.factor, beyond.factor);
}

TEST(Contraction, FactorIsTheCubeRootOfTheJacobiansDeterminant) {
  int beyond = 0;
  for (const Contraction& contraction : {kRoad, kRoom})
    for (int i = 0; i < 200; ++i) {
      const double reach = std::exp2(4 * uniform(2, i)),
                   u[3] = {uniform(3, 3 * i), uniform(3, 3 * i + 1), uniform(3, 3 * i + 2)};
      const Jacobian jacobian(contraction, world_at(contraction, u, reach));
      // A determinant's six products of entries, each up to a few dozen roundings, of which none is
      // above the diagonal's.
      EXPECT_NEAR(std::pow(jacobian.factor, 3) / jacobian.determinant(), 1, 200 * 0x1p-53) << i;
      beyond += contraction.unbounded && jacobian.factor < 0.25 / 8;
    }
  EXPECT_GT(beyond, 50);
  EXPECT_LT(beyond, 150);
}

TEST(Contraction, BoundedSceneFillsTheUnitCube) {
  const double low[3] = {-5, -9, -7.5}, high[3] = {11, 7, 8.5}, beyond[3] = {19, -1, 0.5};
  double unit[3];
  EXPECT_EQ(contract(kRoom, low, unit), 0.5 / 8);
  for (const double y : unit) EXPECT_EQ(y, 0);
  contract(kRoom, high, unit);
  for (const double y : unit) EXPECT_EQ(y, 1);
  EXPECT_EQ(contract(kRoom, beyond, unit), 0.5 / 8);
  EXPECT_EQ(unit[0], 1.5);
  EXPECT_EQ(unit[1], 0.5);
}

}  // namespace
}  // namespace redrive
