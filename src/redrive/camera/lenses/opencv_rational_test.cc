// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/lenses/opencv_rational.h"

#include <cmath>

#include <gtest/gtest.h>
#include <opencv2/calib3d.hpp>

#include "redrive/camera/example_cameras_testing.h"

namespace redrive {
namespace {

TEST(OpenCvRational, AgreesWithOpenCv) {
  int compared = 0;
  for (const ExampleCamera& example : example_cameras()) {
    const Camera& camera = example.camera;
    const auto* lens = std::get_if<OpenCvRational>(&camera.model);
    if (!lens) continue;
    SCOPED_TRACE(example.name);
    std::vector<cv::Point3d> points;
    std::vector<Eigen::Vector2d> ours;
    for (const Eigen::Vector3d& direction : directions(5000))
      if (const auto pixel = camera.project(direction)) {
        points.emplace_back(direction.x(), direction.y(), direction.z());
        ours.push_back(*pixel);
      }
    ASSERT_GT(points.size(), 100u);
    const cv::Matx33d k(camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1);
    const std::vector<double> coefficients = {lens->k1, lens->k2, lens->p1, lens->p2,
                                              lens->k3, lens->k4, lens->k5, lens->k6};
    std::vector<cv::Point2d> theirs;
    cv::projectPoints(points, cv::Vec3d(), cv::Vec3d(), k, coefficients, theirs);
    for (std::size_t i = 0; i < points.size(); ++i) {
      const double distance = std::hypot(ours[i].x() - camera.cx, ours[i].y() - camera.cy);
      ASSERT_LT(std::hypot(ours[i].x() - theirs[i].x, ours[i].y() - theirs[i].y),
                1e-9 * (1 + distance))
          << points[i];
    }
    ++compared;
  }
  EXPECT_GE(compared, 3);
}

// r / (1 - s) has a pole at r = 1, where its derivative (1 + s) / (1 - s)^2 is still positive.
TEST(OpenCvRational, EndsBeforeThePole) {
  const OpenCvRational lens(std::array{0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0});
  EXPECT_LT(lens.max_radius, 1);
  EXPECT_NEAR(lens.max_radius, 1, 1e-8);
  EXPECT_TRUE(lens.project<double>({0.99, 0, 1}));
  EXPECT_FALSE(lens.project<double>({1.01, 0, 1}));
  const auto back = lens.unproject({0.5 / 0.75, 0});
  ASSERT_TRUE(back);
  EXPECT_NEAR(back->x(), 0.5, 1e-12);
}

}  // namespace
}  // namespace redrive
