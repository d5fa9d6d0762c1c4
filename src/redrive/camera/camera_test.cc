// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/camera.h"

#include <cmath>

#include <ceres/jet.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/camera/example_cameras_testing.h"

namespace redrive {
namespace {

// Tests every whole and half pixel. Pixels without a direction are outside the covered radius.
TEST(Camera, RoundTripsOverTheWholeImage) {
  for (const ExampleCamera& example : example_cameras()) {
    SCOPED_TRACE(example.name);
    const Camera& camera = example.camera;
    int valid = 0, invalid = 0;
    for (double v = -0.5; v < camera.height; v += 0.5)
      for (double u = -0.5; u < camera.width; u += 0.5) {
        const Eigen::Vector2d pixel(u, v);
        const auto direction = camera.unproject(pixel);
        if (!direction) {
          ++invalid;
          const double distance =
              std::hypot((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy);
          ASSERT_GT(distance, camera.covered_radius() - 1e-9) << u << ' ' << v;
          continue;
        }
        ++valid;
        ASSERT_NEAR(direction->norm(), 1, 1e-15 * 4);
        const auto back = camera.project(*direction * 3.7);
        ASSERT_TRUE(back) << u << ' ' << v;
        ASSERT_LT((*back - pixel).norm(), 1e-6) << u << ' ' << v;
      }
    EXPECT_GT(valid, 0);
    const bool expected = example.name.find("fold") != std::string::npos ||
                          example.name.find("sphere") != std::string::npos ||
                          example.name == "sixth order" || example.name == "fisheye";
    if (!example.name.starts_with("typical")) {
      EXPECT_EQ(invalid > 0, expected) << invalid;
    }
  }
}

// The model is one-to-one: every direction that has a pixel is the direction of that pixel.
TEST(Camera, UnprojectInvertsProject) {
  for (const ExampleCamera& example : example_cameras()) {
    SCOPED_TRACE(example.name);
    const Camera& camera = example.camera;
    int valid = 0;
    for (const Eigen::Vector3d& direction : directions(20000)) {
      const auto pixel = camera.project(direction);
      if (!pixel) continue;
      ++valid;
      const auto back = camera.unproject(*pixel);
      ASSERT_TRUE(back) << direction.transpose();
      // On the edge of the valid region a pixel determines its radius to the square root of its own
      // rounding: (1e-12)^(1/2) f at worst.
      const double distance =
          std::hypot((pixel->x() - camera.cx) / camera.fx, (pixel->y() - camera.cy) / camera.fy);
      const bool at_edge = distance > 0.999 * camera.covered_radius();
      ASSERT_LT((*back - direction).norm(), at_edge ? 1e-5 : 1e-9) << direction.transpose();
    }
    EXPECT_GT(valid, 1000);
  }
}

TEST(Camera, RejectsPointsOutsideTheValidRegion) {
  for (const ExampleCamera& example : example_cameras()) {
    SCOPED_TRACE(example.name);
    const Camera& camera = example.camera;
    EXPECT_FALSE(camera.project({0, 0, -1}));
    EXPECT_FALSE(camera.project({0, 0, 0}));
    EXPECT_FALSE(camera.project({NAN, 0, 1}));
    EXPECT_FALSE(camera.unproject({NAN, 10}));
    EXPECT_FALSE(camera.unproject({INFINITY, 10}));
    ASSERT_TRUE(camera.project({0, 0, 2}));
    if (example.name.find("windshield") != std::string::npos) continue;  // bends the axis
    EXPECT_LT((*camera.project({0, 0, 2}) - Eigen::Vector2d(camera.cx, camera.cy)).norm(), 1e-12);
    EXPECT_LT((*camera.unproject({camera.cx, camera.cy}) - Eigen::Vector3d(0, 0, 1)).norm(), 1e-12);
  }
}

TEST(Camera, RejectsPointsBeyondTheFold) {
  // r g(r^2) with k1 = -0.4: r = 0.8 and r = 1.0198... have the same image; only the first is
  // valid.
  const Camera camera = example_cameras()[3].camera;
  const double distorted_radius = 0.8 * (1 - 0.4 * 0.64);
  // 0.4 r^3 - r + distorted_radius = 0 divided by (r - 0.8): 0.4 r^2 + 0.32 r - 0.744.
  const double folded = (-0.32 + std::sqrt(0.32 * 0.32 + 4 * 0.4 * 0.744)) / 0.8;
  ASSERT_NEAR(folded * (1 - 0.4 * folded * folded), distorted_radius, 1e-12);
  EXPECT_TRUE(camera.project({0.8, 0, 1}));
  EXPECT_FALSE(camera.project({folded, 0, 1}));
  const auto direction = camera.unproject({camera.cx + camera.fx * distorted_radius, camera.cy});
  ASSERT_TRUE(direction);
  EXPECT_NEAR(direction->x() / direction->z(), 0.8, 1e-12);
}

TEST(Camera, JetsAgreeWithFiniteDifferences) {
  using Jet = ceres::Jet<double, 3>;
  // Central differences of a function of order 1 on points of length 1: step^2 f'''/6 (f''' <= 1e3
  // this far from the edge) and 2e-16 / step of rounding.
  const double step = 1e-6, tolerance = 1e-8;
  for (const ExampleCamera& example : example_cameras()) {
    SCOPED_TRACE(example.name);
    int tested = 0;
    std::visit(
        [&](const auto& model) {
          for (const Eigen::Vector3d& direction : directions(400)) {
            const double angle = std::acos(direction.z());
            if (angle > 1 || !model.template project<double>(
                                 {1.1 * direction.x(), 1.1 * direction.y(), direction.z()}))
              continue;
            ++tested;
            const auto gradient = model.template project<Jet>(
                {Jet(direction.x(), 0), Jet(direction.y(), 1), Jet(direction.z(), 2)});
            ASSERT_TRUE(gradient);
            for (int k = 0; k < 3; ++k) {
              std::array<double, 3> ahead{direction.x(), direction.y(), direction.z()},
                  behind = ahead;
              ahead[k] += step;
              behind[k] -= step;
              const auto a = model.template project<double>(ahead),
                         b = model.template project<double>(behind);
              ASSERT_TRUE(a && b);
              for (int i = 0; i < 2; ++i)
                ASSERT_NEAR((*gradient)[i].v[k], ((*a)[i] - (*b)[i]) / (2 * step), tolerance)
                    << direction.transpose();
            }
          }
        },
        example.camera.model);
    EXPECT_GT(tested, 10);
  }
}

TEST(Camera, DownscaledPixelIsTheMeanOfItsBlock) {
  for (const ExampleCamera& example : example_cameras()) {
    const Camera& camera = example.camera;
    const Camera small = camera.downscaled(3);
    EXPECT_EQ(small.width, 106);
    EXPECT_EQ(small.height, 66);
    // Pixel (k, l) covers the pixels 3k..3k+2, whose centre is 3k + 1.
    const auto direction = small.unproject({50, 40});
    ASSERT_TRUE(direction);
    EXPECT_LT((*camera.project(*direction) - Eigen::Vector2d(151, 121)).norm(), 1e-9);
  }
}

TEST(Camera, UndistortedIsThePinholeOfTheSameMatrix) {
  const Camera camera = example_cameras()[1].camera, plain = camera.undistorted();
  EXPECT_EQ(plain.info().name, "opencv_pinhole");
  const auto pixel = plain.project({0.2, -0.1, 2});
  ASSERT_TRUE(pixel);
  EXPECT_NEAR(pixel->x(), camera.fx * 0.1 + camera.cx, 1e-12);
  EXPECT_NEAR(pixel->y(), -camera.fy * 0.05 + camera.cy, 1e-12);
  EXPECT_THROW(example_cameras()[6].camera.undistorted(), std::logic_error);
}

TEST(Camera, RejectsUnknownModels) {
  CameraCalibration calibration;
  calibration.name = "CAM";
  calibration.model = "rational";
  calibration.parameters = {1, 1, 0, 0};
  try {
    make_camera(calibration);
    FAIL();
  } catch (const InputError& error) {
    EXPECT_NE(std::string(error.what()).find("CAM.model = rational"), std::string::npos)
        << error.what();
  }
}

}  // namespace
}  // namespace redrive
