// SPDX-License-Identifier: Apache-2.0
// The projection of a LiDAR's beams, as kernels use it.
#include "redrive/camera/lenses/spherical.h"

#include <cmath>
#include <numbers>

#include <gtest/gtest.h>

#include "redrive/camera/example_cameras_testing.h"
#include "redrive/camera/plain_camera.h"

namespace redrive {
namespace {

using Math = NumberMath<double>;

constexpr double kPerRadian = 512;  // exact in floats
const SphericalCamera kCamera = make_spherical_camera(kPerRadian, 1.5, 64, 32);

PlainPixel<Math> projected(const Eigen::Vector3d& point) {
  return project<Math>(kCamera, point.x(), point.y(), point.z());
}

TEST(Spherical, AnglesGrowToTheRightAndDown) {
  for (const double azimuth : {-1.2, -0.4, 0.0, 0.7})
    for (const double elevation : {-0.8, 0.0, 0.5}) {
      const Eigen::Vector3d direction(std::cos(elevation) * std::sin(azimuth), std::sin(elevation),
                                      std::cos(elevation) * std::cos(azimuth));
      const PlainPixel<Math> at = projected(3.7 * direction);
      EXPECT_TRUE(at.valid);
      EXPECT_NEAR(at.u, kPerRadian * azimuth, 1e-9);
      EXPECT_NEAR(at.v, kPerRadian * elevation, 1e-9);
    }
}

TEST(Spherical, NothingIsValidBehindOrAtThePoles) {
  EXPECT_FALSE(projected({0, 0, -1}).valid);
  EXPECT_FALSE(projected({1, 0, -0.01}).valid);
  EXPECT_FALSE(projected({0, 1, 0}).valid);
  EXPECT_FALSE(projected({0, -1, 0}).valid);
  EXPECT_TRUE(projected({1, 0, 0.2}).valid);
}

TEST(Spherical, DerivativesAreThoseOfDifferences) {
  constexpr double kStep = 1e-5;
  int compared = 0;
  for (const Eigen::Vector3d& direction : directions(300)) {
    const Eigen::Vector3d point = 2.3 * direction;
    if (!projected(point).valid) continue;
    ++compared;
    double d_u[3] = {}, d_v[3] = {};
    project_adjoint<Math>(kCamera, point.x(), point.y(), point.z(), 1, 0, d_u);
    project_adjoint<Math>(kCamera, point.x(), point.y(), point.z(), 0, 1, d_v);
    // u changes faster towards the poles, and its third derivative with it.
    const double across = std::hypot(point.x(), point.z()),
                 most = 1e-9 * kPerRadian / std::pow(across, 3);
    for (int k = 0; k < 3; ++k) {
      const Eigen::Vector3d step = kStep * Eigen::Vector3d::Unit(k);
      const PlainPixel<Math> ahead = projected(point + step), behind = projected(point - step);
      EXPECT_NEAR(d_u[k], (ahead.u - behind.u) / (2 * kStep), most) << point.transpose();
      EXPECT_NEAR(d_v[k], (ahead.v - behind.v) / (2 * kStep), most) << point.transpose();
    }
  }
  EXPECT_GT(compared, 100);
}

}  // namespace
}  // namespace redrive
