// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/actors/actor_gaussians.h"

#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "redrive/methods/splat/densify_gaussians.h"
#include "redrive/methods/splat/splat_scene_testing.h"

namespace redrive {
namespace {

/// A camera that stands still and looks along x; a car 4 m long drives away from it, 10 m ahead.
/// Images are red in the left half, blue in the right one.
struct Road : SplatScene {
  MovingObject car{.id = 3, .type = "CAR", .size_m = {4, 2, 1.6}, .keys = {}};

  Road() {
    add_camera("CAMERA", "opencv_pinhole", {100, 100, 49.5, 29.5, 0, 0, 0, 0, 0}, 100, 60);
    Rigid3d looking = Rigid3d::Identity();  // camera z is x of the world
    looking.linear() << 0, 0, 1, -1, 0, 0, 0, -1, 0;
    looking.translation().z() = 1;
    for (int i = 0; i < 4; ++i) {
      add_view(0, looking, i == 1);
      Rigid3d pose = Rigid3d::Identity();
      pose.translation() = Eigen::Vector3d(10 + i, 0, 0.8);
      car.keys.push_back({100'000'000ll * i, pose, {10, 0, 0}});
    }
    finish();
    for (Image8& image : images)
      for (std::size_t i = 0; 3 * i < image.rgb.size(); ++i)
        image.rgb[3 * i + (i % 100 < 50 ? 0 : 2)] = 255;
    scene.actors = {car};
  }
  /// Returns on the left half of the rear.
  void add_returns(int n) {
    for (int i = 0; i < n; ++i)
      lidar.on_objects.push_back({3, 100'000'000ll * (i % 4),
                                  Eigen::Vector3f(-2, 0.3f + 0.6f * float(i % 30) / 30,
                                                  -0.6f + 1.2f * float(i / 30) / 30)});
    lidar.on_objects.push_back({4, 0, Eigen::Vector3f(0, 0, 0)});
  }
  GaussianList gaussians(std::uint64_t key = 1, int threads = 2, float ahead_m = kShadow_m) {
    ThreadPool pool(threads);
    return actor_gaussians(data(), car, 0.005f, ahead_m, key, pool);
  }
};

constexpr std::size_t kInCore = 54, kInShadow = 150;  // they come last, in this order
constexpr std::size_t kAdded = kInCore + kInShadow;

TEST(ActorGaussians, LieOnReturnsAndTheirMirrorImagesInTheColoursOfTheImages) {
  Road road;
  road.add_returns(900);
  const GaussianList list = road.gaussians();
  int left = 0, right = 0;
  for (std::size_t i = 0; i < list.size() - kAdded; ++i) {
    const float* const rows = &list.rows[i * kGaussianRows];
    EXPECT_NEAR(rows[kPositionRow], -2, 1e-4) << "no return of another object";
    EXPECT_GT(std::fabs(rows[kPositionRow + 1]), 0.2f);
    const bool is_left = rows[kPositionRow + 1] > 0;
    (is_left ? left : right) += 1;
    EXPECT_EQ(rows[kColourRow], is_left ? 1 : 0);
    EXPECT_EQ(rows[kColourRow + 2], is_left ? 0 : 1);
    EXPECT_NEAR(rows[kDistanceRow], 8, 0.5) << "from the nearest camera, in the car's axes";
  }
  EXPECT_GT(left, 100);
  EXPECT_EQ(left, right);
}

TEST(ActorGaussians, WithoutReturnsLieOnTheBox) {
  Road road;
  const GaussianList list = road.gaussians();
  ASSERT_EQ(list.size(), 500 + kAdded);
  for (std::size_t i = 0; i < 500; ++i) {
    const float* const at = &list.rows[i * kGaussianRows + kPositionRow];
    const float sides[3] = {std::fabs(at[0]) / 1.8f, std::fabs(at[1]) / 0.9f, at[2] / 0.72f};
    EXPECT_NEAR(std::max({sides[0], sides[1], sides[2]}), 1, 1e-4);
  }
  EXPECT_EQ(road.gaussians(1, 1).rows, list.rows);
  EXPECT_NE(road.gaussians(2, 1).rows, list.rows);
}

// The camera stands 12 m to the left of the car. Red tells how far a pixel is from the middle: the
// right side, which it does not see, has the colours of the left one, at 11.1 m.
TEST(ActorGaussians, ASideThatNoImageShowsHasTheColoursOfTheOtherOne) {
  Road road;
  for (FramePose& frame : road.scene.trajectory) {
    // Camera z is -y of the world, x is -x.
    frame.global_from_body.linear() << -1, 0, 0, 0, 0, -1, 0, -1, 0;
    frame.global_from_body.translation() = Eigen::Vector3d(10, 12, 1);
  }
  for (MovingObject::Key& key : road.car.keys) key.world_from_box.translation().x() = 10;
  for (Image8& image : road.images)
    for (std::size_t i = 0; 3 * i < image.rgb.size(); ++i)
      image.rgb[3 * i] =
          static_cast<std::uint8_t>(std::min(255.0, 12 * std::abs(double(i % 100) - 49.5)));
  const GaussianList list = road.gaussians();
  int right = 0;
  for (std::size_t i = 0; i < 500; ++i) {
    const float* const rows = &list.rows[i * kGaussianRows];
    const float along = std::fabs(rows[kPositionRow]);
    if (rows[kPositionRow + 1] > -0.89f || along < 0.8f || along > 1.3f) continue;
    if (std::fabs(rows[kPositionRow + 2]) > 0.3f) continue;  // past the core
    ++right;
    // On its own, at 12.9 m, it would be 1 pixel and more nearer to the middle.
    EXPECT_NEAR(rows[kColourRow] * 255 / 12, 100 * along / 11.1f, 0.6f);
  }
  EXPECT_GT(right, 5);
}

TEST(ActorGaussians, HaveAnOpaqueCoreOfTheMeanColourUnlessTheyDeform) {
  Road road;
  road.add_returns(900);
  const GaussianList list = road.gaussians();
  Eigen::Vector3f sum = Eigen::Vector3f::Zero();
  for (std::size_t i = list.size() - kAdded; i < list.size() - kInShadow; ++i) {
    const float* const rows = &list.rows[i * kGaussianRows];
    const Eigen::Vector3f at(rows[kPositionRow], rows[kPositionRow + 1], rows[kPositionRow + 2]);
    EXPECT_TRUE((at.cwiseAbs().array() < Eigen::Array3f(1.4f, 0.7f, 0.56f)).all()) << at;
    sum += at;
    EXPECT_NEAR(1 / (1 + std::exp(-rows[kOpacityRow])), 0.95, 1e-5);
    EXPECT_NEAR(rows[kColourRow], 0.5, 0.03) << "red on the left, blue on the right";
    EXPECT_NEAR(rows[kColourRow + 2], 0.5, 0.03);
  }
  EXPECT_LT(sum.norm(), 1e-4);
  road.car.type = "PEDESTRIAN";
  EXPECT_EQ(road.gaussians().size(), list.size() - kInCore);
}

TEST(ActorGaussians, HaveABlackHazeOnTheRoadAroundTheBox) {
  Road road;
  const GaussianList list = road.gaussians();
  Eigen::Vector2f lowest(10, 10), highest(-10, -10);
  for (std::size_t i = list.size() - kInShadow; i < list.size(); ++i) {
    const float* const rows = &list.rows[i * kGaussianRows];
    const Eigen::Vector2f at(rows[kPositionRow], rows[kPositionRow + 1]);
    lowest = lowest.cwiseMin(at);
    highest = highest.cwiseMax(at);
    EXPECT_NEAR(rows[kPositionRow + 2], 0.05 - 0.8, 1e-5);
    EXPECT_NEAR(1 / (1 + std::exp(-rows[kOpacityRow])), 0.1, 1e-5);
    for (int c = 0; c < 3; ++c) EXPECT_EQ(rows[kColourRow + c], 0);
  }
  EXPECT_LT((highest - Eigen::Vector2f(2.8f, 1.8f)).norm(), 1e-4);
  EXPECT_LT((lowest + highest).norm(), 1e-4);
}

TEST(ActorGaussians, HaveAHazeAheadInTheDark) {
  Road road;
  const GaussianList list = road.gaussians(1, 2, kHeadlights_m), shadow = road.gaussians();
  float last = 0, first = 0;
  int ahead = 0;
  for (std::size_t i = 0; i < list.size(); ++i) {
    const float x = list.rows[i * kGaussianRows + kPositionRow];
    last = std::max(last, x);
    first = std::min(first, x);
    ahead += x > 3;
  }
  EXPECT_NEAR(last, 2 + kHeadlights_m - 0.2f, 0.02f);
  EXPECT_NEAR(first, -2.8f, 0.02f);
  EXPECT_EQ(list.size() - shadow.size(), static_cast<std::size_t>(ahead))
      << "what is around the box stays";
}

TEST(ActorGaussians, AnObjectThatNoTrainingImageShowsHasNone) {
  Road road;
  road.add_returns(900);
  for (MovingObject::Key& key : road.car.keys) key.t_ns += 10'000'000'000;
  EXPECT_EQ(road.gaussians().size(), 0u);
}

}  // namespace
}  // namespace redrive
