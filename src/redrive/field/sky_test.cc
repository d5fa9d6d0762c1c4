// SPDX-License-Identifier: Apache-2.0
#include "redrive/field/sky.h"

#include <cmath>

#include <ceres/jet.h>
#include <gtest/gtest.h>

namespace redrive {
namespace {

TEST(Sky, DirectionsLieInTheUnitCube) {
  EXPECT_EQ(sky_coordinate(-1.0f), 0);
  EXPECT_EQ(sky_coordinate(0.0f), 0.5f);
  EXPECT_EQ(sky_coordinate(1.0f), 1);
  // A pixel of 0.01 rad is 0.005 wide on a sphere of half the unit sphere's size; the footprint is
  // half of that.
  EXPECT_FLOAT_EQ(sky_footprint(0.01f), 0.0025f);
}

TEST(Sky, ColourIsTheSigmoidOfTheSumOverLevels) {
  // Every second value belongs to another colour.
  const double features[] = {0.5, 9, -2, 9, 0.25, 9};
  EXPECT_DOUBLE_EQ(sky_colour(features, 3, 2), 1 / (1 + std::exp(1.25)));
  EXPECT_DOUBLE_EQ(sky_colour(features, 1, 2), 1 / (1 + std::exp(-0.5)));
  EXPECT_DOUBLE_EQ(sky_colour(features + 1, 3, 2), 1 / (1 + std::exp(-27)));
}

TEST(SkyAdjoint, AgreesWithJets) {
  using Jet = ceres::Jet<double, 3>;
  const double features[] = {0.5, -2, 0.25};
  Jet jets[3];
  for (int l = 0; l < 3; ++l) jets[l] = Jet(features[l], l);
  const double got = sky_colour_adjoint(sky_colour(features, 3, 1), -0.75);
  const Jet expected = sky_colour(jets, 3, 1);
  for (const double slope : expected.v) EXPECT_NEAR(got, -0.75 * slope, 4 * 0x1p-53);
  using Jet1 = ceres::Jet<double, 1>;
  EXPECT_EQ(sky_coordinate_adjoint(3.0), 3 * sky_coordinate(Jet1(0.3, 0)).v[0]);
}

}  // namespace
}  // namespace redrive
