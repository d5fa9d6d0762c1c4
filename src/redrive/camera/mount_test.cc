// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/mount.h"

#include <cmath>

#include <gtest/gtest.h>

namespace redrive {
namespace {

using Eigen::Vector3d;

TEST(Mount, LooksForwardWithLevelRows) {
  const Rigid3d pose = Mount{{1.5, 0.25, 1.75}, 0, 0, 0}.body_from_sensor();
  EXPECT_TRUE((pose * Vector3d::Zero()).isApprox(Vector3d(1.5, 0.25, 1.75)));
  EXPECT_TRUE((pose.linear() * Vector3d::UnitZ()).isApprox(Vector3d::UnitX()));   // forward
  EXPECT_TRUE((pose.linear() * Vector3d::UnitX()).isApprox(-Vector3d::UnitY()));  // right
  EXPECT_NEAR(pose.linear().determinant(), 1, 1e-12);
}

TEST(Mount, TurnsLeftUpAndClockwise) {
  const auto forward = [](const Mount& mount) -> Vector3d {
    return mount.body_from_sensor().linear().col(2);
  };
  EXPECT_TRUE(forward({Vector3d::Zero(), 90, 0, 0}).isApprox(Vector3d::UnitY()));
  EXPECT_TRUE(forward({Vector3d::Zero(), 90, 90, 0}).isApprox(Vector3d::UnitZ()));
  EXPECT_TRUE(forward({Vector3d::Zero(), 90, 30, 77})
                  .isApprox(Vector3d(0, std::cos(M_PI / 6), std::sin(M_PI / 6))));
  // The right end of a row goes down.
  const Rigid3d rolled = Mount{Vector3d::Zero(), 0, 0, 90}.body_from_sensor();
  EXPECT_TRUE((rolled.linear() * Vector3d::UnitX()).isApprox(-Vector3d::UnitZ()));
}

TEST(Mount, ReadsSixNumbers) {
  const auto mount = parse_mount("1.5,-0.2,1e0,-90,3.25,360");
  ASSERT_TRUE(mount);
  EXPECT_EQ(mount->position_m, Vector3d(1.5, -0.2, 1));
  EXPECT_EQ(mount->yaw_deg, -90);
  EXPECT_EQ(mount->pitch_deg, 3.25);
  EXPECT_EQ(mount->roll_deg, 360);
  for (const char* text :
       {"", "1,2,3,4,5", "1,2,3,4,5,", "1,2,3,4,5,6,7", "1,2,3,4,5,x", "1;2;3;4;5;6",
        "1,2,1e5,4,5,6", "1,2,3,361,5,6", "nan,2,3,4,5,6", " 1,2,3,4,5,6"})
    EXPECT_FALSE(parse_mount(text)) << text;
}

TEST(Lens, PinholeHasItsFieldOfView) {
  const auto lens = parse_lens("pinhole:90:1280x704");
  ASSERT_TRUE(lens);
  EXPECT_EQ(lens->camera, "");
  const Camera camera = lens->pinhole();
  EXPECT_EQ(camera.width, 1280);
  EXPECT_EQ(camera.height, 704);
  const double middle = 351.5;
  EXPECT_TRUE(camera.unproject({639.5, middle})->isApprox(Vector3d::UnitZ()));
  EXPECT_TRUE(camera.unproject({-0.5, middle})->isApprox(Vector3d(-1, 0, 1).normalized()));
  EXPECT_TRUE(camera.unproject({1279.5, middle})->isApprox(Vector3d(1, 0, 1).normalized()));
}

TEST(Lens, ReadsACameraOrAPinhole) {
  EXPECT_EQ(parse_lens("F_FISHEYE_C")->camera, "F_FISHEYE_C");
  for (const char* text : {"", "pinhole:", "pinhole:90", "pinhole:90:1280", "pinhole:0.5:64x64",
                           "pinhole:171:64x64", "pinhole:nan:64x64", "pinhole:90:8x64",
                           "pinhole:90:64x5000", "pinhole:90:64x64x", "pinhole:90:-64x64"})
    EXPECT_FALSE(parse_lens(text)) << text;
}

}  // namespace
}  // namespace redrive
