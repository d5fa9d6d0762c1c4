// SPDX-License-Identifier: Apache-2.0
// Pinholes with OpenCV's coefficients: opencv_pinhole, opencv_rational, opencv_thin_prism.
#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <opencv2/calib3d.hpp>

#include "redrive/camera/example_cameras_testing.h"
#include "redrive/camera/lenses/opencv_coefficients.h"
#include "redrive/camera/lenses/opencv_thin_prism.h"

namespace redrive {
namespace {

using ::testing::Each;
using ::testing::ElementsAre;
using ::testing::Ge;

void expect_as_opencv(const Camera& camera, const OpenCvCoefficients& coefficients) {
  std::vector<cv::Point3d> points;
  std::vector<Eigen::Vector2d> ours;
  for (const Eigen::Vector3d& direction : directions(5000))
    if (const auto pixel = camera.project(direction * 4); pixel && pixel->norm() < 1e4) {
      points.emplace_back(4 * direction.x(), 4 * direction.y(), 4 * direction.z());
      ours.push_back(*pixel);
    }
  ASSERT_GT(points.size(), 100u);
  const cv::Matx33d k(camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1);
  std::vector<cv::Point2d> theirs;
  cv::projectPoints(points, cv::Vec3d(), cv::Vec3d(), k,
                    std::vector<double>(coefficients.begin(), coefficients.end()), theirs);
  for (std::size_t i = 0; i < points.size(); ++i) {
    const double distance = std::hypot(ours[i].x() - camera.cx, ours[i].y() - camera.cy);
    ASSERT_LT(std::hypot(ours[i].x() - theirs[i].x, ours[i].y() - theirs[i].y),
              1e-9 * (1 + distance))
        << points[i];
  }
}

TEST(OpenCvPinholes, AgreeWithOpenCv) {
  std::array<int, 3> compared{};
  for (const ExampleCamera& example : example_cameras()) {
    SCOPED_TRACE(example.name);
    if (const auto* lens = std::get_if<OpenCvPinhole>(&example.camera.model)) {
      const BrownConrady& c = lens->distortion;
      expect_as_opencv(example.camera, {c.k1, c.k2, c.p1, c.p2, c.k3});
      ++compared[0];
    } else if (const auto* c = std::get_if<OpenCvRational>(&example.camera.model)) {
      expect_as_opencv(example.camera, {c->k1, c->k2, c->p1, c->p2, c->k3, c->k4, c->k5, c->k6});
      ++compared[1];
    } else if (const auto* c = std::get_if<OpenCvThinPrism>(&example.camera.model)) {
      expect_as_opencv(example.camera, {c->k1, c->k2, c->p1, c->p2, c->k3, c->k4, c->k5, c->k6,
                                        c->sx1, c->sx2, c->sy1, c->sy2});
      ++compared[2];
    }
  }
  EXPECT_THAT(compared, Each(Ge(3)));
}

// r / (1 - s) has a pole at r = 1, where its derivative (1 + s) / (1 - s)^2 is still positive.
TEST(OpenCvPinholes, RationalEndsBeforeThePole) {
  const OpenCvRational lens(std::array{0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0});
  EXPECT_LT(lens.max_radius, 1);
  EXPECT_NEAR(lens.max_radius, 1, 1e-8);
  EXPECT_TRUE(lens.project<double>({0.99, 0, 1}));
  EXPECT_FALSE(lens.project<double>({1.01, 0, 1}));
  const auto back = lens.unproject({0.5 / 0.75, 0});
  ASSERT_TRUE(back);
  EXPECT_NEAR(back->x(), 0.5, 1e-12);
}

// Along x, x + s2 x^4 with s2 = -1/4 folds at x = 1. At other angles the bound, 1 > 2/sqrt(3) r^3,
// is sharper.
TEST(OpenCvPinholes, APrismEndsBeforeItFolds) {
  std::array<double, 12> c{};
  c[9] = -0.25;
  const OpenCvThinPrism lens(c);
  EXPECT_NEAR(lens.max_radius, std::cbrt(std::sqrt(3.0) / 2), 1e-8);
  const auto d = lens.project<double>({0.5, 0, 1});
  ASSERT_TRUE(d);
  EXPECT_NEAR((*d)[0], 0.5 - 0.25 / 16, 1e-15);
  EXPECT_FALSE(lens.project<double>({1, 0, 1}));
}

// x + s1 x^2 with s1 = -1/4 folds at x = 2, where the bound ends.
TEST(OpenCvPinholes, ALinearPrismEndsWhereItFolds) {
  std::array<double, 12> c{};
  c[8] = -0.25;
  EXPECT_NEAR(OpenCvThinPrism(c).max_radius, 2, 1e-8);
}

TEST(OpenCvPinholes, WithoutAPrismEndsAsRational) {
  const std::array rational = {-0.4, 0.0, 0.01, 0.0, 0.0, 0.1, 0.0, 0.0};
  std::array<double, 12> all{};
  std::ranges::copy(rational, all.begin());
  EXPECT_EQ(OpenCvThinPrism(all).max_radius, OpenCvRational(rational).max_radius);
}

TEST(OpenCvPinholes, TakeTheModelWithTheFewestCoefficients) {
  CameraCalibration camera;
  camera.parameters = {9, 8, 7, 6};
  set_opencv_coefficients({1, 2, 3, 4}, &camera);
  EXPECT_EQ(camera.model, "opencv_pinhole");
  EXPECT_THAT(camera.parameters, ElementsAre(9, 8, 7, 6, 1, 2, 3, 4, 0));
  set_opencv_coefficients({0, 0, 0, 0, 0, 5}, &camera);
  EXPECT_EQ(camera.model, "opencv_rational");
  EXPECT_THAT(camera.parameters, ElementsAre(9, 8, 7, 6, 0, 0, 0, 0, 0, 5, 0, 0));
  const OpenCvCoefficients prism = {1, 2, 3, 4, 5, 6, 7, 8, 0, 9};
  set_opencv_coefficients(prism, &camera);
  EXPECT_EQ(camera.model, "opencv_thin_prism");
  EXPECT_EQ(opencv_coefficients(camera), prism);
  camera.model = "fov";
  EXPECT_FALSE(opencv_coefficients(camera));
}

}  // namespace
}  // namespace redrive
