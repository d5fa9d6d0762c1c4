// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/lenses/ftheta_intrinsics.h"

#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/camera/camera.h"
#include "redrive/camera/lenses/roots.h"

namespace redrive {
namespace {

/// A lens of 200 degrees with 900 pixels per radian, and a shear.
FThetaIntrinsics wide_lens(bool angle_is_reference) {
  FThetaIntrinsics lens;
  lens.cx = 957.25;
  lens.cy = 603.5;
  lens.angle_is_reference = angle_is_reference;
  lens.angle_to_pixeldist = {0, 900, 4, -30, 6, -1.5};
  lens.pixeldist_to_angle = {0, 1.0 / 900, -6e-9, 5e-11, -1e-14, 3e-18};
  lens.max_angle_rad = 1.75;
  lens.c = 1.002;
  lens.d = 3e-4;
  lens.e = -5e-4;
  return lens;
}

CameraCalibration calibration_of(const FThetaIntrinsics& lens) {
  CameraCalibration camera{.name = "front", .width = 1920, .height = 1208};
  set_ftheta(lens, "rig.json", "front.", &camera);
  return camera;
}

TEST(FTheta, FollowsTheReferencePolynomial) {
  for (const bool inverse : {false, true}) {
    const FThetaIntrinsics lens = wide_lens(inverse);
    const Camera camera = make_camera(calibration_of(lens));
    for (const double angle : {1e-9, 0.3, 1.2, 1.7})
      for (const double turn : {0.2, 2.5, 4.4}) {
        SCOPED_TRACE(testing::Message() << inverse << ' ' << angle << ' ' << turn);
        const Eigen::Vector3d ray(std::sin(angle) * std::cos(turn),
                                  std::sin(angle) * std::sin(turn), std::cos(angle));
        const auto pixel = camera.project(3 * ray);
        ASSERT_TRUE(pixel);
        // The pixel without the shear, whose distance and angle obey the polynomial.
        Eigen::Matrix2d shear;
        shear << lens.c, lens.d, lens.e, 1;
        const Eigen::Vector2d offset =
            shear.inverse() * (*pixel - Eigen::Vector2d(lens.cx, lens.cy));
        EXPECT_NEAR(offset.normalized().x(), std::cos(turn), 1e-4);
        if (inverse)
          EXPECT_NEAR(horner(lens.pixeldist_to_angle, offset.norm()), angle, 1e-9);
        else
          EXPECT_NEAR(horner(lens.angle_to_pixeldist, angle), offset.norm(), 1e-6);
        const auto back = camera.unproject(*pixel);
        ASSERT_TRUE(back);
        EXPECT_NEAR((*back - ray).norm(), 0, 1e-9);
      }
    EXPECT_FALSE(camera.project({std::sin(1.76), 0, std::cos(1.76)})) << "beyond max_angle";
  }
}

TEST(FTheta, IntrinsicsComeBack) {
  for (const bool inverse : {false, true}) {
    const FThetaIntrinsics lens = wide_lens(inverse);
    const auto back = ftheta_intrinsics(calibration_of(lens));
    ASSERT_TRUE(back);
    EXPECT_EQ(back->angle_is_reference, inverse);
    const auto& expected = inverse ? lens.pixeldist_to_angle : lens.angle_to_pixeldist;
    const auto& reference = inverse ? back->pixeldist_to_angle : back->angle_to_pixeldist;
    for (std::size_t i = 0; i < expected.size(); ++i)
      EXPECT_NEAR(reference[i], expected[i], 1e-12 * std::abs(expected[i])) << i;
    EXPECT_NEAR(back->d, lens.d, 1e-15);
    EXPECT_NEAR(back->max_angle_rad, lens.max_angle_rad, 1e-12);
    // The other polynomial is the inverse to a tenth of a pixel.
    for (const double r_px : {10.0, 400.0, 1200.0})
      EXPECT_NEAR(horner(back->angle_to_pixeldist, horner(back->pixeldist_to_angle, r_px)), r_px,
                  0.1);
  }
  CameraCalibration other;
  other.model = "fov";
  EXPECT_FALSE(ftheta_intrinsics(other));
}

TEST(FTheta, RefusesPolynomialsByName) {
  const auto refused = [](auto change) -> std::string {
    FThetaIntrinsics lens = wide_lens(true);
    change(lens);
    try {
      calibration_of(lens);
    } catch (const InputError& error) {
      return error.field;
    }
    return "nothing";
  };
  EXPECT_EQ(refused([](auto&) {}), "nothing");
  EXPECT_EQ(refused([](auto& l) { l.pixeldist_to_angle = {0}; }), "front.pixeldist_to_angle_poly");
  EXPECT_EQ(refused([](auto& l) { l.pixeldist_to_angle.resize(7); }),
            "front.pixeldist_to_angle_poly");
  EXPECT_EQ(refused([](auto& l) { l.pixeldist_to_angle[0] = 0.1; }),
            "front.pixeldist_to_angle_poly[0]");
  EXPECT_EQ(refused([](auto& l) { l.pixeldist_to_angle[1] = -0.1; }),
            "front.pixeldist_to_angle_poly[1]");
  EXPECT_EQ(refused([](auto& l) { l.pixeldist_to_angle[3] = NAN; }),
            "front.pixeldist_to_angle_poly");
  EXPECT_EQ(refused([](auto& l) { l.c = 0; }), "front.linear_cde.c");
  EXPECT_EQ(refused([](auto& l) { l.e = 0.7; }), "front.shear_y");
  EXPECT_EQ(refused([](auto& l) { l.max_angle_rad = 4; }), "front.max_angle");
}

}  // namespace
}  // namespace redrive
