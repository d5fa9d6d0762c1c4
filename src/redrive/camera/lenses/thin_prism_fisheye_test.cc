// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/lenses/thin_prism_fisheye.h"

#include <cmath>

#include <gtest/gtest.h>

#include "redrive/camera/lenses/opencv_fisheye.h"

namespace redrive {
namespace {

TEST(ThinPrismFisheye, IsOpenCvFisheyeWithoutTangentialTerms) {
  const OpenCvFisheye fisheye(std::array{0.03, 0.005, 0.0007, -0.0001});
  const ThinPrismFisheye prism(std::array{0.03, 0.005, 0.0, 0.0, 0.0007, -0.0001, 0.0, 0.0});
  EXPECT_NEAR(prism.max_angle_rad, fisheye.max_angle_rad, 1e-12);
  for (const double z : {-0.5, 0.1, 3.0}) {
    const auto a = fisheye.project<double>({1, -2, z}), b = prism.project<double>({1, -2, z});
    ASSERT_TRUE(a && b);
    EXPECT_NEAR((*a)[0], (*b)[0], 1e-14);
    EXPECT_NEAR((*a)[1], (*b)[1], 1e-14);
  }
}

// At 45 degrees to the right the point is (pi / 4, 0).
TEST(ThinPrismFisheye, AddsTangentialAndPrismTerms) {
  const ThinPrismFisheye prism(std::array{0.0, 0.0, 0.001, 0.002, 0.0, 0.0, 0.004, 0.008});
  const double a = std::atan(1.0), s = a * a;
  const auto d = prism.project<double>({1, 0, 1});
  ASSERT_TRUE(d);
  EXPECT_NEAR((*d)[0], a + 0.002 * 3 * s + 0.004 * s, 1e-15);
  EXPECT_NEAR((*d)[1], 0.001 * s + 0.008 * s, 1e-15);
}

}  // namespace
}  // namespace redrive
