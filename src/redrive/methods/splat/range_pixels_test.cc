// SPDX-License-Identifier: Apache-2.0
// LiDAR returns in the image of a camera that looks along x from the origin, 0.1 s per view.
#include "redrive/methods/splat/range_pixels.h"

#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "redrive/methods/splat/splat_scene_testing.h"

namespace redrive {
namespace {

constexpr double kFocal_px = 100, kCx = 49.5, kCy = 29.5;

struct LidarScene : SplatScene {
  LidarScene() {
    add_camera("CAMERA", "opencv_pinhole", {kFocal_px, kFocal_px, kCx, kCy, 0, 0, 0, 0, 0}, 100,
               60);
    Rigid3d looking = Rigid3d::Identity();  // camera z is x of the world
    looking.linear() << 0, 0, 1, -1, 0, 0, 0, -1, 0;
    for (int i = 0; i < 6; ++i) add_view(0, looking);
    finish();
  }
  /// A return of the static world at a point, from the origin.
  void add_return(const Eigen::Vector3d& at, std::int64_t t_ns) { returns_.push_back({at, t_ns}); }
  std::vector<RangePixel> pixels(std::size_t view) {
    auto on_objects = std::move(lidar.on_objects);
    lidar = returns_of(scene, returns_);
    lidar.on_objects = std::move(on_objects);
    ThreadPool pool(2);
    return range_pixels(scene, scene.views[view],
                        find_shown_returns(data(), ReturnTimes(lidar), view), pool);
  }

 private:
  std::vector<MeasuredPoint> returns_;
};

TEST(RangePixels, AreWhereTheCameraSeesTheReturn) {
  LidarScene scene;
  scene.add_return({10, 1.02, -0.52}, 0);  // to the left and below
  scene.add_return({-10, 0, 0}, 0);        // behind the camera
  scene.add_return({10, 20, 0}, 0);        // beside the image
  const std::vector<RangePixel> found = scene.pixels(0);
  ASSERT_EQ(found.size(), 1u);
  EXPECT_EQ(found[0].x, static_cast<int>(std::floor(kCx - 10.2 + 0.5)));
  EXPECT_EQ(found[0].y, static_cast<int>(std::floor(kCy + 5.2 + 0.5)));
  EXPECT_NEAR(found[0].log_range, std::log(std::sqrt(100 + 1.02 * 1.02 + 0.52 * 0.52)), 1e-5);
}

TEST(RangePixels, AreOneOfAPixelTheFirst) {
  LidarScene scene;
  scene.add_return({10.2, 1.04, -0.53}, 0);
  scene.add_return({10, 1.02, -0.52}, 0);
  scene.add_return({10, -1.02, -0.52}, 0);
  const std::vector<RangePixel> found = scene.pixels(0);
  ASSERT_EQ(found.size(), 2u);
  EXPECT_NEAR(found[0].log_range, std::log(std::hypot(10.2, 1.04, 0.53)), 1e-5);
  EXPECT_NE(found[0].x, found[1].x);
}

TEST(RangePixels, AreOfAboutTheTimeOfTheImage) {
  LidarScene scene;
  scene.add_return({10, 0, 0}, 0);
  scene.add_return({10, 3, 0}, 400'000'000);
  EXPECT_EQ(scene.pixels(0).size(), 1u);
  EXPECT_EQ(scene.pixels(4).size(), 1u);
  EXPECT_NE(scene.pixels(0)[0].x, scene.pixels(4)[0].x);
  scene.scene.metric = false;  // photographs have no times
  EXPECT_EQ(scene.pixels(0).size(), 2u);
}

// LiDAR and camera ride on the body.
TEST(RangePixels, FollowTheCorrectedPoses) {
  LidarScene scene;
  scene.add_return({10, 0, 0}, 0);
  const int x = scene.pixels(0).at(0).x, y = scene.pixels(0).at(0).y;
  PoseCorrections corrections(scene.scene);
  corrections.values[corrections.frame_slot(0)] = 1;  // to the right
  scene.scene.correct(corrections);
  EXPECT_EQ(scene.pixels(0).at(0).x, x) << "the body";
  corrections = PoseCorrections(scene.scene);
  corrections.values[corrections.camera_slot(0) + 1] = 0.5f;  // down
  scene.scene.correct(corrections);
  EXPECT_EQ(scene.pixels(0).at(0).x, x);
  EXPECT_EQ(scene.pixels(0).at(0).y, y - 5) << "the camera";
}

TEST(RangePixels, ATimeIsFoundAmongManyReturns) {
  constexpr std::int64_t kReturns = 100'000, kApart_ns = 1'000'000;
  LidarReturns lidar;
  lidar.n = kReturns;
  for (std::int64_t i = 0; i < kReturns; ++i)  // neighbours change places, as lasers do
    lidar.t_ns.push_back(kApart_ns * (i ^ 1));
  const ReturnTimes times(lidar);
  for (const std::int64_t i : {0l, 1l, 4095l, 4096l, 50'000l, kReturns - 1}) {
    const auto ranges = times.ranges(kApart_ns * (i - 10), kApart_ns * (i + 10));
    std::size_t read = 0;
    for (std::int64_t k = std::max(0l, i - 10); k <= std::min(kReturns - 1, i + 10); ++k)
      EXPECT_EQ(std::ranges::count_if(ranges,
                                      [&](const ReturnTimes::Range& range) {
                                        const auto at = static_cast<std::size_t>(k ^ 1);
                                        return at >= range.first && at < range.second;
                                      }),
                1)
          << k;
    for (const auto& [begin, end] : ranges) read += end - begin;
    EXPECT_LE(read, 3 * 4096u) << "at " << i;
  }
  EXPECT_TRUE(times.ranges(-10, -1).empty());
  EXPECT_TRUE(ReturnTimes(LidarReturns()).ranges(0, 1).empty());
}

TEST(RangePixels, LeaveOutWhatANearerReturnHides) {
  LidarScene scene;
  scene.add_return({10, 0, 0}, 0);
  scene.add_return({20, 0.1, 0}, 0);
  scene.add_return({20, 8, 0}, 0);  // far enough in the image
  const std::vector<RangePixel> found = scene.pixels(0);
  ASSERT_EQ(found.size(), 2u);
  EXPECT_EQ(std::ranges::count_if(found, [](const RangePixel& p) { return p.log_range < 2.4f; }),
            1);
}

/// A car that drives away from the camera at 20 m/s, 10 m ahead at first.
MovingObject leaving() {
  MovingObject car{.id = 3, .type = "CAR", .size_m = {4, 2, 2}, .keys = {}};
  for (int i = 0; i < 6; ++i) {
    Rigid3d pose = Rigid3d::Identity();
    pose.translation().x() = 12 + 2 * i;
    car.keys.push_back({100'000'000ll * i, pose, {20, 0, 0}});
  }
  return car;
}

TEST(RangePixels, ReturnsOnAnObjectMoveAlongWithIt) {
  LidarScene scene;
  scene.scene.actors = {leaving()};
  scene.lidar.on_objects.push_back({3, 0, Eigen::Vector3f(-2, 0.5f, 0)});  // on its rear
  // an object that does not exist
  scene.lidar.on_objects.push_back({4, 0, Eigen::Vector3f(-2, 0.5f, 0)});
  for (const std::size_t view : {0u, 1u}) {
    const std::vector<RangePixel> found = scene.pixels(view);
    ASSERT_EQ(found.size(), 1u);
    const double x = 10 + 2 * double(view);
    EXPECT_NEAR(found[0].log_range, std::log(std::hypot(x, 0.5)), 1e-5);
    EXPECT_EQ(found[0].x, static_cast<int>(std::floor(kCx - kFocal_px * 0.5 / x + 0.5)));
  }
  EXPECT_TRUE(scene.pixels(2).empty()) << "0.2 s later";
}

TEST(RangePixels, AnObjectHidesWhatTheSensorSawBefore) {
  LidarScene scene;
  scene.add_return({40, 0, 0}, 0);
  scene.add_return({40, 15, 0}, 0);
  EXPECT_EQ(scene.pixels(0).size(), 2u);
  scene.scene.actors = {leaving()};
  EXPECT_EQ(scene.pixels(0).size(), 1u);
  scene.scene.actors[0].hidden_ns = {{0, 50'000'000}};
  EXPECT_EQ(scene.pixels(0).size(), 2u);
}

}  // namespace
}  // namespace redrive
