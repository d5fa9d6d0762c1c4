// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/lidar/lidar_points.h"

#include <gtest/gtest.h>

#include "redrive/scene/lidar/lidar_testing.h"
#include "redrive/scene/load_views.h"
#include "redrive/scene/scene_testing.h"

namespace redrive {
namespace {

using Eigen::Vector3d;
using Colour = std::array<int, 3>;

constexpr int kFisheye = 0, kFront = 1;

// One camera of make_test_recording, whose colours name camera, frame and pixel.
class LidarPointsTest : public ::testing::Test {
 protected:
  void open(int camera = kFront, SceneOptions options = {}) {
    options.cameras = {recording_.cameras[camera].calibration.name};
    scene_ = make_scene(recording_, options);
    images_ = load_views(scene_, pool_);
  }

  /// The point that pixel (x, y) shows at `range_m`.
  Vector3d seen(int frame, int x, int y, double range_m) const {
    const Camera& camera = scene_.rig[0].camera;
    return scene_.shutter_poses(scene_.views[frame]).at_pixel(0, y, camera.width, camera.height) *
           Vector3d(range_m * *camera.unproject(Eigen::Vector2d(x, y)));
  }
  void add(const Vector3d& in_world, std::int64_t t_ns) { measured_.push_back({in_world, t_ns}); }

  PointCloud points() {
    return lidar_points(scene_, images_,
                        returns_of(scene_, measured_, scene_.rig[0].body_from_sensor.translation()),
                        pool_);
  }
  std::vector<Colour> colours() {
    const PointCloud cloud = points();
    std::vector<Colour> colours(cloud.n);
    for (std::size_t i = 0; i < cloud.n; ++i)
      for (int d = 0; d < 3; ++d)
        colours[i][d] = static_cast<int>(std::lround(255 * cloud.rgb[d * cloud.n + i]));
    return colours;
  }
  static Colour colour(int camera, int frame, int x, int y) {
    const auto rgb = test_colour(camera, frame, x, y);
    return {rgb[0], rgb[1], rgb[2]};
  }
  std::int64_t time(int frame) const { return scene_.frames[frame].t_ns; }

  TemporaryFolder folder_;
  Recording recording_ = make_test_recording(folder_.path);
  Scene scene_;
  std::vector<Image8> images_;
  ThreadPool pool_{3};
  std::vector<MeasuredPoint> measured_;
};

TEST_F(LidarPointsTest, TakesThePixelThatShowsTheReturn) {
  for (const int camera : {kFisheye, kFront}) {
    open(camera);
    measured_.clear();
    std::vector<Colour> expected;
    std::vector<Vector3d> in_world;
    for (const int frame : {1, 4})
      for (const int x : {4, 9, 15})
        for (const int y : {3, 8}) {
          in_world.push_back(seen(frame, x, y, 5 + x));
          add(in_world.back(), time(frame));
          expected.push_back(colour(camera, frame, x, y));
        }
    EXPECT_EQ(colours(), expected);
    const PointCloud cloud = points();
    for (std::size_t i = 0; i < cloud.n; ++i)
      for (int d = 0; d < 3; ++d)
        EXPECT_NEAR(cloud.position[d * cloud.n + i], in_world[i][d], 1e-5) << i;
  }
}

// The car moves by half a metre and turns by 3 degrees, two pixels, while an image is read.
TEST_F(LidarPointsTest, ProjectsThroughARollingShutter) {
  recording_.cameras[kFront].calibration.readout_ns = 33'000'000;
  open();
  std::vector<Colour> expected;
  for (const int x : {6, 12, 18})
    for (const int y : {0, 3, 8, 12, 15}) {
      add(seen(2, x, y, 12), time(2));
      expected.push_back(colour(kFront, 2, x, y));
    }
  EXPECT_EQ(colours(), expected);
}

TEST_F(LidarPointsTest, PrefersTheViewNearestInTime) {
  recording_.cameras[kFront].calibration.time_offset_ns = 10'000'000;
  open();
  const Vector3d ahead = seen(3, 12, 8, 30);
  add(ahead, time(2) + 42'000'000);  // half the frames' distance is 33 ms
  add(ahead, time(2) + 45'000'000);
  const std::vector<Colour> colours = this->colours();
  ASSERT_EQ(colours.size(), 2u);
  EXPECT_EQ(colours[0][2], 128 + 20);
  EXPECT_EQ(colours[1], colour(kFront, 3, 12, 8));
}

TEST_F(LidarPointsTest, SkipsHeldOutMaskedAndTransparentPixels) {
  SceneOptions options;
  options.holdout_every = 3;  // frames 0 and 3
  open(kFront, options);
  const Vector3d ahead = seen(3, 12, 8, 30);
  add(ahead, time(3) + 1'000'000);
  EXPECT_EQ(colours().at(0)[2], 128 + 40) << "frame 3 is held out, 4 is nearer than 2";
  images_[4].used.assign(24 * 16, 0);
  EXPECT_EQ(colours().at(0)[2], 128 + 20);
  images_[2].alpha.assign(24 * 16, 254);
  EXPECT_EQ(colours().at(0)[2], 128 + 50) << "a view further away in time sees it, too";
  for (Image8& image : images_) image.used.assign(24 * 16, 0);
  EXPECT_EQ(points().n, 0u);
}

TEST_F(LidarPointsTest, LeavesOutReturnsThatNoImageShows) {
  open();
  add(scene_.world_from_body(time(2)) * Vector3d(-20, -5, 1), time(2));
  add(seen(2, 3, 3, 10), time(2));
  EXPECT_EQ(colours(), std::vector<Colour>{colour(kFront, 2, 3, 3)});
}

TEST_F(LidarPointsTest, PhotographsTakeTheViewNearestToTheOrigin) {
  open();
  scene_.metric = false;
  const Vector3d ahead = seen(5, 12, 8, 30);
  add(ahead, time(5));
  add(ahead, time(1));
  const std::vector<Colour> colours = this->colours();
  ASSERT_EQ(colours.size(), 2u);
  EXPECT_EQ(colours[0], colour(kFront, 5, 12, 8));
  EXPECT_EQ(colours[1][2], 128 + 10);
}

}  // namespace
}  // namespace redrive
