// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/lenses/mei.h"

#include <cmath>

#include <gtest/gtest.h>

#include "redrive/camera/example_cameras_testing.h"

namespace redrive {
namespace {

TEST(Mei, ValidRegionEndsAtTheEdgeOfTheSphere) {
  const Camera camera =
      example_cameras()[8].camera;  // xi = 1.5: cos a > -1/xi, r < 1/sqrt(xi^2 - 1)
  const auto at_angle = [](double a) { return Eigen::Vector3d(std::sin(a), 0, std::cos(a)); };
  const double edge = std::acos(-1 / 1.5);
  EXPECT_TRUE(camera.project(at_angle(edge - 1e-3)));
  EXPECT_FALSE(camera.project(at_angle(edge + 1e-3)));
  const double reach = camera.fx / std::sqrt(1.5 * 1.5 - 1);
  EXPECT_TRUE(camera.unproject({camera.cx + reach * (1 - 1e-6), camera.cy}));
  EXPECT_FALSE(camera.unproject({camera.cx + reach * (1 + 1e-6), camera.cy}));
}

TEST(Mei, ParabolicMirrorIsStereographic) {  // xi = 1: r = sin a / (1 + cos a) = tan(a / 2)
  const Camera camera = example_cameras()[9].camera;
  for (const double angle : {0.1, 1.0, 2.0, 3.0}) {
    const auto pixel = camera.project({0, std::sin(angle), std::cos(angle)});
    ASSERT_TRUE(pixel);
    EXPECT_NEAR(pixel->y(), camera.cy + camera.fy * std::tan(angle / 2), 1e-9);
  }
}

}  // namespace
}  // namespace redrive
