// SPDX-License-Identifier: Apache-2.0
#include "redrive/math/rigid3.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace redrive {
namespace {

using ::testing::HasSubstr;

Eigen::Matrix4d quarter_turn() {
  Eigen::Matrix4d m;
  m << 0, -1, 0, 10, 1, 0, 0, 20, 0, 0, 1, 30, 0, 0, 0, 1;
  return m;
}

TEST(RigidObstacle, AcceptsRotationsAndDescribesErrors) {
  EXPECT_EQ(rigid_obstacle(quarter_turn()), "");
  Eigen::Matrix4d m = quarter_turn();
  m.row(2).head<3>() *= -1;
  EXPECT_THAT(rigid_obstacle(m), HasSubstr("det = -1, a reflection"));
  m = quarter_turn();
  m.topLeftCorner<3, 3>() *= 1.01;  // R R^T = 1.0201 I
  EXPECT_THAT(rigid_obstacle(m), HasSubstr("not orthonormal by 0.0201"));
  m = quarter_turn();
  m(3, 0) = 0.5;
  EXPECT_THAT(rigid_obstacle(m), HasSubstr("last row"));
  m = quarter_turn();
  m(0, 0) = NAN;
  EXPECT_EQ(rigid_obstacle(m), "not finite");
  EXPECT_NE(rigid_obstacle(Eigen::Matrix4d::Zero()), "");
}

// Agrees with Eigen to a few units in the last place: small angles, half turns, none, quaternions
// of either sign.
TEST(PlainPose, InterpolatesAsEigensSlerp) {
  for (int i = 0; i < 200; ++i) {
    const Eigen::Vector3d axis = Eigen::Vector3d(std::sin(i), std::cos(3 * i), 0.3).normalized();
    Rigid3d a(Eigen::AngleAxisd(0.7 * i, axis));
    a.translation() = Eigen::Vector3d(i, -2, 0.5);
    Rigid3d b = a;
    b.rotate(Eigen::AngleAxisd(i % 4 == 0   ? 0
                               : i % 4 == 1 ? 1e-6
                                            : 0.015 * i,
                               axis.cross(a.linear().col(0)).normalized()));
    b.translation() += Eigen::Vector3d(1, 2, 3);
    for (const double fraction : {0.0, 0.25, 1.0, 1.5}) {
      const Rigid3d got = interpolate(a, b, fraction);
      const Eigen::Matrix3d expected = Eigen::Quaterniond(a.linear())
                                           .slerp(fraction, Eigen::Quaterniond(b.linear()))
                                           .toRotationMatrix();
      EXPECT_LT((got.linear() - expected).cwiseAbs().maxCoeff(), 2e-15) << i << ", " << fraction;
      EXPECT_LT(
          (got.translation() - (a.translation() + fraction * Eigen::Vector3d(1, 2, 3))).norm(),
          1e-13);
    }
  }
}

TEST(PlainPose, RotatesVectorsAsItsMatrix) {
  Rigid3d pose(Eigen::AngleAxisd(0.9, Eigen::Vector3d(1, -2, 3).normalized()));
  pose.translation() = Eigen::Vector3d(4, 5, 6);
  const Eigen::Vector3d vector(0.3, -0.7, 0.2), expected = pose.linear() * vector;
  for (int k = 0; k < 3; ++k)
    EXPECT_NEAR(rotated(plain(pose), vector.data(), k), expected[k], 1e-15);
  EXPECT_EQ((rigid(plain(pose)).matrix() - pose.matrix()).cwiseAbs().maxCoeff(), 0);
}

}  // namespace
}  // namespace redrive
