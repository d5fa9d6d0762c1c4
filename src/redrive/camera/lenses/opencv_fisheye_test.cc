// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/lenses/opencv_fisheye.h"

#include <cmath>
#include <numbers>

#include <gtest/gtest.h>
#include <opencv2/calib3d.hpp>

#include "redrive/camera/example_cameras_testing.h"

namespace redrive {
namespace {

TEST(OpenCvFisheye, EquidistantProjectsBehindTheCamera) {
  const Camera camera = example_cameras()[11].camera;
  for (const double angle : {0.1, 1.0, 2.0, 3.0}) {
    const auto pixel = camera.project({0, 5 * std::sin(angle), 5 * std::cos(angle)});
    ASSERT_TRUE(pixel);
    EXPECT_NEAR(pixel->y(), camera.cy + camera.fy * angle, 1e-9);
    const auto direction = camera.unproject(*pixel);
    ASSERT_TRUE(direction);
    EXPECT_LT((*direction - Eigen::Vector3d(0, std::sin(angle), std::cos(angle))).norm(), 1e-11);
  }
  EXPECT_FALSE(camera.unproject({camera.cx, camera.cy + 3.15 * camera.fy}))
      << "beyond straight behind";
}

// theta = a - 0.1 a^3 rises to a = 1 / sqrt(0.3).
TEST(OpenCvFisheye, ValidRegionEndsWhereThetaFalls) {
  const OpenCvFisheye fisheye(std::array{-0.1, 0.0, 0.0, 0.0});
  EXPECT_NEAR(fisheye.max_angle_rad, 1 / std::sqrt(0.3), 1e-12);
  const auto at = [](double a) { return std::array<double, 3>{std::sin(a), 0, std::cos(a)}; };
  EXPECT_TRUE(fisheye.project<double>(at(fisheye.max_angle_rad - 1e-6)));
  EXPECT_FALSE(fisheye.project<double>(at(fisheye.max_angle_rad + 1e-6)));
  EXPECT_NEAR(OpenCvFisheye().max_angle_rad, std::numbers::pi, 1e-8);
}

TEST(OpenCvFisheye, AgreesWithOpenCv) {
  int compared = 0;
  for (const ExampleCamera& example : example_cameras()) {
    const Camera& camera = example.camera;
    const OpenCvFisheye* fisheye = std::get_if<OpenCvFisheye>(&camera.model);
    if (!fisheye) continue;
    SCOPED_TRACE(example.name);
    std::vector<cv::Point3d> points;
    std::vector<Eigen::Vector2d> ours;
    for (const Eigen::Vector3d& direction : directions(5000)) {
      if (direction.z() < 0.01) continue;  // OpenCV divides by z
      points.emplace_back(4 * direction.x(), 4 * direction.y(), 4 * direction.z());
      const auto pixel = camera.project(direction * 4);
      ASSERT_TRUE(pixel);
      ours.push_back(*pixel);
    }
    const cv::Matx33d k(camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1);
    std::vector<cv::Point2d> theirs;
    cv::fisheye::projectPoints(points, theirs, cv::Vec3d(), cv::Vec3d(), k,
                               cv::Vec4d(fisheye->k1, fisheye->k2, fisheye->k3, fisheye->k4));
    for (std::size_t i = 0; i < points.size(); ++i)
      ASSERT_LT(std::hypot(ours[i].x() - theirs[i].x, ours[i].y() - theirs[i].y), 1e-6)
          << points[i];
    ++compared;
  }
  EXPECT_GE(compared, 3);
}

}  // namespace
}  // namespace redrive
