// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/ray_share.h"

#include <gtest/gtest.h>

namespace redrive {
namespace {

CameraCalibration pinhole(double k1, double k2) {
  CameraCalibration c;
  c.name = "CAM";
  c.model = "opencv_pinhole";
  c.parameters = {80, 80, 39.5, 29.5, k1, k2, 0, 0, 0};
  c.width = 80;
  c.height = 60;
  return c;
}

TEST(RayShare, CountsPixelsOutsideTheValidRegion) {
  EXPECT_EQ(percent_without_ray(make_camera(pinhole(0, 0))), 0);
  // 1 - 3 k r^2 = 0 at r = 0.1715: 0.1143 in the image, a disc of 9.15 pixels.
  const double percent = percent_without_ray(make_camera(pinhole(-11.33, 0)));
  EXPECT_NEAR(percent, 100 * (1 - 3.1416 * 9.15 * 9.15 / 4800), 1);
  EXPECT_GT(percent_without_ray(make_camera(pinhole(-300, 0))), kMostWithoutRay);
  EXPECT_EQ(without_ray_text(12.34),
            "12.3 % of the pixels lie outside the radius where the distortion is one-to-one");
}

}  // namespace
}  // namespace redrive
