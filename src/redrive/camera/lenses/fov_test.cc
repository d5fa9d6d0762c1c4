// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/lenses/fov.h"

#include <array>
#include <cmath>

#include <gtest/gtest.h>

namespace redrive {
namespace {

TEST(Fov, FollowsItsFormula) {
  const Fov fov(std::array{0.9});
  const auto d = fov.project<double>({0.6, 0, 2});
  ASSERT_TRUE(d);
  EXPECT_NEAR((*d)[0], std::atan(2 * 0.3 * std::tan(0.45)) / 0.9, 1e-15);
  EXPECT_EQ((*d)[1], 0);
}

TEST(Fov, IsContinuousAtTheAxisAndWithoutDistortion) {
  const Fov wide(std::array{0.9});
  EXPECT_NEAR((*wide.project<double>({1e-10, 0, 1}))[0] / 1e-10,
              (*wide.project<double>({1e-8, 0, 1}))[0] / 1e-8, 1e-12);
  const Fov narrow(std::array{1e-7});
  EXPECT_NEAR((*narrow.project<double>({0.4, -0.3, 1}))[0], 0.4, 1e-14);
  const auto back = narrow.unproject({0.4, -0.3});
  ASSERT_TRUE(back);
  EXPECT_NEAR(back->y() / back->z(), -0.3, 1e-14);
}

}  // namespace
}  // namespace redrive
