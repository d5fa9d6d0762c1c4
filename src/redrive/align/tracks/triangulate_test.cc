// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/tracks/triangulate.h"

#include <gtest/gtest.h>

namespace redrive {
namespace {

/// A camera at (x, y, 0) that looks along z.
Rigid3d at(double x, double y) { return Rigid3d(Eigen::Translation3d(x, y, 0)); }

CameraCalibration pinhole() {
  return {
      "FRONT", "opencv_pinhole", {300, 290, 159.5, 119.5, -0.3, 0.08, 0.002, 0.0006, 0}, 320, 240};
}
CameraCalibration fisheye() {
  return {"FISHEYE", "mei", {150, 140, 159.5, 119.5, 0.03, -0.08, 0, 0, 0, 1.02}, 320, 240};
}

class Triangulate : public ::testing::Test {
 protected:
  std::vector<Camera> cameras_ = {make_camera(pinhole()), make_camera(fisheye())};
  std::vector<Rigid3d> poses_;
  Track track_;

  void see(const Eigen::Vector3d& point, int camera, const Rigid3d& pose) {
    const auto pixel = cameras_[camera].project(pose.inverse() * point);
    ASSERT_TRUE(pixel);
    track_.seen.push_back({camera, static_cast<int>(poses_.size()), *pixel});
    poses_.push_back(pose);
  }
};

TEST_F(Triangulate, IsExactForExactPixelsOfBothModels) {
  const Eigen::Vector3d point(0.7, -0.4, 5);
  see(point, 0, at(0, 0));
  see(point, 1, at(0.5, 0.1) * Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitY()));
  const auto two = triangulate(track_, poses_, cameras_);
  ASSERT_TRUE(two);
  EXPECT_LT((*two - point).norm(),
            1e-5);  // unproject is exact to 1e-6 px, 300 px a radian, 10 times the baseline away
  see(point, 0, at(1, 0));
  const auto three = triangulate(track_, poses_, cameras_);
  ASSERT_TRUE(three);
  EXPECT_LT((*three - point).norm(), 1e-5);
}

TEST_F(Triangulate, ReturnsNothingWithoutParallax) {
  const Eigen::Vector3d point(0.7, -0.4, 5);
  see(point, 0, at(0, 0));
  EXPECT_FALSE(triangulate(track_, poses_, cameras_));  // one ray
  see(point, 0, at(0, 0));
  EXPECT_FALSE(triangulate(track_, poses_, cameras_));  // the same ray twice
  see(point, 1, at(0, 0));
  EXPECT_FALSE(triangulate(track_, poses_, cameras_));
}

TEST_F(Triangulate, AcceptsParallaxFromTheMinimumAngle) {
  const Eigen::Vector3d point(0, 0, 10);
  see(point, 0, at(-0.1, 0));
  see(point, 0, at(0.1, 0));  // 0.02 rad
  EXPECT_TRUE(triangulate(track_, poses_, cameras_, {.min_angle_rad = 0.019}));
  EXPECT_FALSE(triangulate(track_, poses_, cameras_, {.min_angle_rad = 0.021}));
}

TEST_F(Triangulate, ReturnsNothingForRaysThatMeetBehindTheCamera) {
  see({1, 0, 5}, 0, at(0, 0));
  see({-1, 0, 5}, 0, at(0, 0));
  poses_[0] = at(0.5, 0);  // the rays diverge
  poses_[1] = at(-0.5, 0);
  EXPECT_FALSE(triangulate(track_, poses_, cameras_));
}

TEST_F(Triangulate, OutvotesOutliers) {
  const Eigen::Vector3d point(0.7, -0.4, 5);
  for (int i = 0; i < 5; ++i) see(point, 0, at(0.3 * i, 0.02 * i * i));
  track_.seen[1].pixel += Eigen::Vector2d(20, -15);
  track_.seen[4].pixel += Eigen::Vector2d(-30, 25);
  const auto found = triangulate(track_, poses_, cameras_);
  ASSERT_TRUE(found);
  EXPECT_LT((*found - point).norm(), 0.02);  // Geman-McClure at 25 px of 3: a weight of 2e-4
}

TEST_F(Triangulate, ReturnsNothingForTwoContradictoryRays) {
  const Eigen::Vector3d point(0.7, -0.4, 5);
  see(point, 0, at(0, 0));
  see(point, 0, at(1, 0));
  track_.seen[1].pixel.y() += 20;  // off the epipolar line
  EXPECT_FALSE(triangulate(track_, poses_, cameras_));
}

TEST_F(Triangulate, MinimisesTheDistanceInPixels) {
  const Eigen::Vector3d point(0.7, -0.4, 5);
  for (int i = 0; i < 6; ++i) {
    see(point, i % 2, at(0.3 * i, 0.1 * (i % 3)));
    track_.seen[i].pixel += 0.3 * Eigen::Vector2d(std::sin(3 * i), std::cos(5 * i));
  }
  const auto cost = [&](const Eigen::Vector3d& p) {
    double sum = 0;
    for (std::size_t i = 0; i < track_.seen.size(); ++i) {
      const double sq =
          reprojection_residual(p, track_.seen[i], poses_[i], cameras_[track_.seen[i].camera])
              ->squaredNorm();
      sum += sq / (sq + 9);
    }
    return sum;
  };
  const auto found = triangulate(track_, poses_, cameras_);
  ASSERT_TRUE(found);
  for (int d = 0; d < 3; ++d)
    for (const double step : {-1e-3, 1e-3})
      EXPECT_GT(cost(*found + step * Eigen::Vector3d::Unit(d)), cost(*found));
}

}  // namespace
}  // namespace redrive
