// SPDX-License-Identifier: Apache-2.0
// LiDAR, boxes and masks of a real recording; skipped where it is missing. The expected values are
// from its SOURCE.md.
#include <gtest/gtest.h>

#include "redrive/perception/masks.h"
#include "redrive/scene/lidar/lidar_returns.h"
#include "redrive/scene/load_views.h"

namespace redrive {
namespace {

class RealNight : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!std::filesystem::exists(root_)) GTEST_SKIP() << root_ << " is not here";
    recording_ = open_recording(root_);
  }
  const std::filesystem::path root_ = REDRIVE_SHARED "/data/aimotive_night";
  Recording recording_;
  ThreadPool pool_{2};
};

TEST_F(RealNight, CountsLidarReturns) {
  const Scene scene = make_scene(recording_, {});
  const MovingObjects moving = read_moving_objects(recording_, scene);
  EXPECT_EQ(moving.objects().size(), 8u);
  EXPECT_EQ(moving.parked().size(), 0u);
  const LidarReturns returns = load_lidar_returns(recording_, scene, moving, pool_);
  EXPECT_GT(returns.n, 3'500'000u);
  EXPECT_NEAR(
      static_cast<double>(returns.repeated) / static_cast<double>(returns.n + returns.repeated),
      1.0 / 3, 0.05);
  EXPECT_EQ(returns.beyond_trajectory,
            0u);                     // the poses reach to within 51 ms of the first and last points
  EXPECT_GT(returns.on_ego, 1000u);  // roof and its rack
  EXPECT_LT(returns.on_ego, 20000u);
  EXPECT_GT(returns.on_moving, 50'000u);
  EXPECT_LT(returns.on_moving, 500'000u);
  for (std::size_t i = 0; i < returns.n; i += 1000) {
    EXPECT_GT(returns.range_m[i], 1) << i;
    EXPECT_LT(returns.range_m[i], 230) << i;  // the range of a Pandar64
  }
}

/// Returns the first row of the vehicle at column x along the outline; nothing beyond its ends.
double outline_row(const std::vector<Eigen::Vector2d>& outline, double x) {
  for (std::size_t i = 1; i < outline.size(); ++i) {
    const Eigen::Vector2d &a = outline[i - 1], &b = outline[i];
    if (x >= a.x() && x <= b.x()) return a.y() + (b.y() - a.y()) * (x - a.x()) / (b.x() - a.x());
  }
  return std::nan("");
}

// The outlines are rough, so 0.95 is the best possible overlap. Half the size and every 8th frame
// held out, as in a run.
TEST_F(RealNight, FindsTheEgoVehicle) {
  struct Known {
    const char* camera;
    std::vector<Eigen::Vector2d> outline;
    int x0, x1, y0, broken;  ///< a box that protrudes above it, the first broken row
  };
  const std::vector<Known> all = {
      {"B_MIDRANGECAM_C",
       {{0, 849}, {392, 916}, {870, 875}, {1100, 875}, {1525, 926}, {1919, 879}},
       895,
       1070,
       844,
       1209},
      {"F_MIDLONGRANGECAM_CL",
       {{0, 565}, {320, 600}, {640, 610}, {960, 600}, {1279, 565}},
       0,
       -1,
       0,
       704},
      {"M_FISHEYE_L",
       {{124, 388}, {373, 508}, {721, 551}, {970, 508}, {1157, 424}},
       970,
       1062,
       400,
       700},
      {"M_FISHEYE_R",
       {{124, 426}, {249, 486}, {498, 541}, {746, 558}, {945, 498}, {1157, 402}},
       229,
       311,
       414,
       700}};
  SceneOptions options;
  options.downscale = 2;
  options.holdout_every = 8;
  const Scene scene = make_scene(recording_, options);
  const std::vector<Mask> masks = static_masks(scene, load_views(scene, pool_), {}, pool_, true);
  for (const Known& known : all) {
    const Mask& mask = masks[scene.camera_index(known.camera)];
    int both = 0, either = 0;
    for (int y = 0; y < mask.height; ++y)
      for (int x = 0; x < mask.width; ++x) {
        const double u = 2 * x + 0.5, v = 2 * y + 0.5, row = outline_row(known.outline, u);
        const bool left_out = !mask.used[std::size_t(y) * mask.width + x];
        if (v > known.broken) {
          EXPECT_TRUE(left_out) << known.camera << ' ' << x << ' ' << y;
        } else if (!std::isnan(row) && v < known.broken - 4) {
          const bool vehicle = v >= row || (u >= known.x0 && u <= known.x1 && v >= known.y0);
          both += vehicle && left_out;
          either += vehicle || left_out;
        }
      }
    std::printf("%s: IoU %.3f\n", known.camera, double(both) / either);
    EXPECT_GT(both, 0.85 * either) << known.camera;
    for (int x = 0; x < mask.width; ++x)  // the sky
      for (int y = 0; y < mask.height / 4; ++y)
        ASSERT_EQ(mask.used[std::size_t(y) * mask.width + x], 1) << known.camera;
  }
}

}  // namespace
}  // namespace redrive
