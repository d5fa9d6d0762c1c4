// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/shutter_poses.h"

#include <gtest/gtest.h>

#include "redrive/recording/core/trajectory.h"
#include "redrive/scene/pose_corrections.h"
#include "redrive/scene/scene.h"
#include "redrive/scene/scene_testing.h"

namespace redrive {
namespace {

double apart(const Rigid3d& a, const Rigid3d& b) {
  return (a.matrix() - b.matrix()).cwiseAbs().maxCoeff();
}

// Line v of n is exposed at time + ((v + 0.5) / n - 0.5) readout.
TEST(ShutterPoses, EachLineHasItsOwnTime) {
  const TemporaryFolder folder;
  Recording recording = make_test_recording(folder.path);
  constexpr std::int64_t kReadout_ns = 40'000'000, kOffset_ns = 7'000'000;
  CameraCalibration& calibration = recording.cameras[1].calibration;
  calibration.readout_ns = kReadout_ns;
  calibration.time_offset_ns = kOffset_ns;
  for (const bool by_column : {false, true}) {
    calibration.readout_by_column = by_column;
    Scene scene = make_scene(recording, {});
    for (const bool again : {false, true}) {  // as corrections set them
      if (again) scene.correct(PoseCorrections(scene));
      for (const View& view : scene.views) {
        const ShutterPoses poses = scene.shutter_poses(view);
        EXPECT_EQ(poses.is_rolling(), view.camera == 1);
        const auto& [width, height] =
            std::pair(scene.rig[view.camera].camera.width, scene.rig[view.camera].camera.height);
        EXPECT_LT(apart(poses.at(0.5), scene.world_from_camera(view)), 1e-4)
            << "the readout contains a corner of the path";
        if (view.camera == 0) continue;
        const PixelPoses of_pixels(poses, width, height);
        for (int y = 0; y < height; ++y)
          for (int x = 0; x < width; ++x) {
            const double part = by_column ? (x + 0.5) / width : (y + 0.5) / height;
            const std::int64_t t_ns = scene.frames[view.frame].t_ns + kOffset_ns +
                                      std::llround((part - 0.5) * double(kReadout_ns));
            const Rigid3d expected = scene.global_from_world.inverse() *
                                     pose_at(recording.frames, t_ns) * calibration.body_from_sensor;
            // Between keys 5 ms apart the path is straight except at its corners, the frames:
            // 0.1 rad in 67 ms.
            EXPECT_LT(apart(poses.at_pixel(x, y, width, height), expected), 5e-3)
                << view.frame << ", pixel " << x << ' ' << y;
            EXPECT_LT(apart(of_pixels.of(static_cast<std::size_t>(y * width + x)), expected), 5e-3);
          }
        EXPECT_GT(apart(poses.at_pixel(0, 0, width, height),
                        poses.at_pixel(width - 1, height - 1, width, height)),
                  0.3)
            << "the camera hardly moves during the readout";
      }
    }
  }
}

TEST(ShutterPoses, ASinglePoseHoldsForAllRows) {
  Rigid3d pose = Rigid3d::Identity();
  pose.translation() = Eigen::Vector3d(1, 2, 3);
  const ShutterPoses poses = pose;
  EXPECT_FALSE(poses.is_rolling());
  EXPECT_EQ(apart(poses.at(0.9), pose), 0);
  EXPECT_EQ(apart(poses.at_pixel(2, 3, 10, 10), pose), 0);
}

TEST(ShutterPoses, InterpolatesBetweenKeys) {
  const auto key = [](double x, double turn) {
    Rigid3d pose(Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitZ()));
    pose.translation().x() = x;
    return pose;
  };
  const ShutterPoses poses({key(0, 0), key(1, 0.2), key(5, 0.2)});
  EXPECT_LT(apart(poses.at(0), key(0, 0)), 1e-15);
  EXPECT_LT(apart(poses.at(0.25), key(0.5, 0.1)), 1e-15);
  EXPECT_LT(apart(poses.at(0.75), key(3, 0.2)), 1e-15);
  EXPECT_LT(apart(poses.at(1), key(5, 0.2)), 1e-15);
}

TEST(ShutterPoses, ShowActorsAtTheTimeOfEachRow) {
  const TemporaryFolder folder;
  Recording recording = make_test_recording(folder.path);
  recording.cameras[1].calibration.readout_ns = 40'000'000;
  recording.cameras[1].calibration.time_offset_ns = 7'000'000;
  Scene scene = make_scene(recording, {});
  const std::int64_t begin_ns = scene.frames.front().t_ns - 100'000'000;
  MovingObject car{.id = 5, .type = "CAR", .size_m = {4, 2, 1.5}, .keys = {}};
  for (int i = 0; i < 100; ++i) {
    Rigid3d pose = Rigid3d::Identity();
    pose.translation() = Eigen::Vector3d(2.0 * i, 3, 1);  // 20 m/s
    car.keys.push_back({begin_ns + 100'000'000ll * i, pose, {20, 0, 0}});
  }
  scene.actors = {car};
  for (const View& view : scene.views) {
    const ShutterPoses poses = scene.shutter_poses(view);
    ASSERT_EQ(poses.actors().size(), 1u);
    EXPECT_EQ(poses.actors()[0].body, 5);
    ASSERT_EQ(poses.actors()[0].actor_from_camera.size(), poses.keys().size());
    for (std::size_t key = 0; key < poses.keys().size(); ++key) {
      const double part = poses.is_rolling() ? double(key) / double(poses.keys().size() - 1) : 0.5;
      const double t_s = 1e-9 * double(scene.frames[view.frame].t_ns - begin_ns +
                                       (view.camera == 1 ? 7'000'000 : 0)) +
                         0.04 * (part - 0.5);
      Rigid3d actor = Rigid3d::Identity();
      actor.translation() = Eigen::Vector3d(20 * t_s, 3, 1);
      EXPECT_LT(apart(rigid(poses.actors()[0].actor_from_camera[key]),
                      actor.inverse() * rigid(poses.keys()[key])),
                1e-5)
          << "key " << key;
    }
  }
  scene.actors[0].keys.resize(1);
  EXPECT_TRUE(scene.shutter_poses(scene.views.back()).actors().empty()) << "it is not there";
}

}  // namespace
}  // namespace redrive
