// SPDX-License-Identifier: Apache-2.0
#include "redrive/view/pace.h"

#include <gtest/gtest.h>

namespace redrive::view {
namespace {

TEST(Pace, BeginsSmall) {
  const Pace pace;
  EXPECT_EQ(pace.factor_within(0.05, 16), Pace::kFirstFactor);
  EXPECT_EQ(pace.factor_within(0.05, 2), 2);
  EXPECT_FALSE(pace.seconds(1).has_value());
}

TEST(Pace, ScalesByPixelsUntilItHasMeasured) {
  Pace pace;
  pace.measured(4, 0.01);
  EXPECT_DOUBLE_EQ(*pace.seconds(2), 0.04);
  EXPECT_DOUBLE_EQ(*pace.seconds(1), 0.16);
  EXPECT_DOUBLE_EQ(*pace.seconds(8), 0.01);  // part of it may not shrink
  EXPECT_EQ(pace.factor_within(0.05, 16), 2);
  EXPECT_EQ(pace.factor_within(0.2, 16), 1);
  pace.measured(1, 0.03);  // most of the work did not depend on the pixels
  EXPECT_EQ(pace.factor_within(0.05, 16), 1);
}

TEST(Pace, FollowsTheScene) {
  Pace pace;
  pace.measured(1, 0.02);
  for (int i = 0; i < 20; ++i) pace.measured(1, 0.2);
  EXPECT_NEAR(*pace.seconds(1), 0.2, 1e-3);
  EXPECT_GT(pace.factor_within(0.05, 16), 1);
}

TEST(Pace, TakesAChangeOfOneFactorForAll) {
  Pace pace;
  pace.measured(1, 0.2);  // others took the processor
  pace.measured(2, 0.05);
  EXPECT_EQ(pace.factor_within(0.06, 16), 2);
  for (int i = 0; i < 20; ++i) pace.measured(2, 0.01);  // now they do not
  EXPECT_NEAR(*pace.seconds(1), 0.04, 1e-4);
  EXPECT_EQ(pace.factor_within(0.06, 16), 1);
}

TEST(Pace, NeverGoesBeyondTheLargestFactor) {
  Pace pace;
  pace.measured(4, 100);
  EXPECT_EQ(pace.factor_within(0.05, 16), 16);
}

}  // namespace
}  // namespace redrive::view
