// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/tracks/epipolar.h"

#include <gtest/gtest.h>

#include "redrive/base/rng.h"

namespace redrive {
namespace {

/// Two cameras of different models, half a metre apart, with common points in view.
class Epipolar : public ::testing::Test {
 protected:
  Camera a_ = make_camera(
      {"A", "opencv_pinhole", {300, 290, 159.5, 119.5, -0.3, 0.08, 0.002, 0.0006, 0}, 320, 240});
  Camera b_ =
      make_camera({"B", "mei", {150, 140, 159.5, 119.5, 0.03, -0.08, 0, 0, 0, 1.02}, 320, 240});
  Rigid3d b_from_a_ = Eigen::Translation3d(0.4, -0.1, 0.3) *
                      Rigid3d(Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitY()));

  Eigen::Vector3d point(int i) const {
    const auto u = [&](int k) { return random_unit(random_key(kStreamTest, 0), 3 * i + k) - 0.5; };
    const double depth = 6 + 8 * u(2);
    return {0.7 * depth * u(0), 0.6 * depth * u(1), depth};
  }
  std::optional<RayPair> pair(const Eigen::Vector3d& in_a,
                              const Eigen::Vector2d& off_b = {0, 0}) const {
    const auto pixel_a = a_.project(in_a), pixel_b = b_.project(b_from_a_ * in_a);
    if (!pixel_a || !pixel_b) return std::nullopt;
    return make_ray_pair(a_, *pixel_a, b_, *pixel_b + off_b);
  }
};

TEST_F(Epipolar, TheSamePointHasZeroErrorAndItsDepth) {
  for (int i = 0; i < 50; ++i) {
    const auto rays = pair(point(i));
    ASSERT_TRUE(rays);
    EXPECT_LT(std::abs(sampson_error_px(*rays, b_from_a_)), 1e-4);
    if (const auto depth = ray_depth(rays->ray_a, rays->ray_b, b_from_a_)) {
      EXPECT_NEAR(*depth, point(i).norm(), 1e-4 * point(i).norm());
    }
  }
}

TEST_F(Epipolar, ErrorIsInStandardDeviationsOfPixels) {
  // With noise of sd 1 px in each coordinate of both images the error has sd 1.
  double squares = 0;
  constexpr int kPoints = 4000;
  const auto noise = [](int i, int k) {  // sd 1: uniform in +-sqrt(3)
    return std::sqrt(3.0) * (2 * random_unit(random_key(kStreamTest, 1), 4 * i + k) - 1);
  };
  for (int i = 0; i < kPoints; ++i) {
    const Eigen::Vector3d x = point(i);
    const auto rays =
        make_ray_pair(a_, *a_.project(x) + Eigen::Vector2d(noise(i, 0), noise(i, 1)), b_,
                      *b_.project(b_from_a_ * x) + Eigen::Vector2d(noise(i, 2), noise(i, 3)));
    squares += std::pow(sampson_error_px(*rays, b_from_a_), 2);
  }
  EXPECT_NEAR(std::sqrt(squares / kPoints), 1,
              0.1);  // 0.01 of sampling; pixels are distorted and not square
}

TEST_F(Epipolar, ErrorDoesNotDependOnTheBaseline) {
  const auto rays = pair(point(0), {1, -2});
  Rigid3d twice = b_from_a_;
  twice.translation() *= 2;
  EXPECT_NEAR(sampson_error_px(*rays, b_from_a_), sampson_error_px(*rays, twice), 1e-9);
  twice.translation().setZero();
  EXPECT_EQ(sampson_error_px(*rays, twice), 0);
}

TEST_F(Epipolar, ParallelAndDivergingRaysHaveNoDepth) {
  EXPECT_FALSE(ray_depth({0, 0, 1}, {0, 0, 1}, Rigid3d(Eigen::Translation3d(1, 0, 0))));
  EXPECT_FALSE(ray_depth({0, 0, 1}, Eigen::Vector3d(1, 0, 1).normalized(),
                         Rigid3d(Eigen::Translation3d(-1, 0, 0))));
  EXPECT_NEAR(*ray_depth({0, 0, 1}, Eigen::Vector3d(1, 0, 1).normalized(),
                         Rigid3d(Eigen::Translation3d(1, 0, 0))),
              1, 1e-12);
}

TEST_F(Epipolar, RefinesAWrongInitialPose) {
  std::vector<RayPair> pairs;
  for (int i = 0; i < 120; ++i) pairs.push_back(*pair(point(i)));
  Rigid3d start = b_from_a_;
  start.rotate(Eigen::AngleAxisd(0.03, Eigen::Vector3d(1, -2, 1).normalized()));
  start.translation() += Eigen::Vector3d(-0.1, 0.2, 0.1);
  const auto pose = fit_relative_pose(pairs, {start});
  ASSERT_TRUE(pose);
  EXPECT_LT(Eigen::AngleAxisd(pose->linear() * b_from_a_.linear().transpose()).angle(), 1e-5);
  EXPECT_LT((pose->translation() - b_from_a_.translation().normalized()).norm(), 1e-4);
  pairs.resize(11);
  EXPECT_FALSE(fit_relative_pose(pairs, {start}));
}

}  // namespace
}  // namespace redrive
