// SPDX-License-Identifier: Apache-2.0
#include "redrive/render/camera_path.h"

#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/math/so3.h"

namespace redrive {
namespace {

const Eigen::Vector3d kAxis = Eigen::Vector3d(1, -2, 0.5).normalized();

Rigid3d pose(const Eigen::Vector3d& position, double angle_rad) {
  Rigid3d made = Rigid3d::Identity();
  made.linear() = so3_exp(angle_rad * kAxis);
  made.translation() = position;
  return made;
}

/// Constant acceleration of position and angle.
PathKey accelerated(double t_s) {
  return {t_s,
          pose({1 + 2 * t_s - 0.3 * t_s * t_s, -t_s, 0.5 * t_s * t_s},
               0.1 + 0.4 * t_s - 0.15 * t_s * t_s),
          40 + 10 * t_s};
}

void expect_same(const PathKey& a, const PathKey& b, double tolerance) {
  EXPECT_NEAR((a.world_from_camera.matrix() - b.world_from_camera.matrix()).norm(), 0, tolerance)
      << "at " << a.t_s << " s";
}

TEST(CameraPath, ReproducesConstantAccelerationAtUnevenTimes) {
  std::vector<PathKey> keys;
  for (const double t_s : {0.0, 0.5, 1.7, 2.0, 3.5}) keys.push_back(accelerated(t_s));
  for (double t_s = 0; t_s <= 3.5; t_s += 0.07) {
    expect_same(interpolate_path(keys, t_s), accelerated(t_s), 1e-12);
    EXPECT_NEAR(interpolate_path(keys, t_s).fov_deg, 40 + 10 * t_s, 1e-12);
  }
}

TEST(CameraPath, IsCatmullRomAtEvenTimes) {
  const std::vector<Eigen::Vector3d> p = {{0, 0, 0}, {1, 3, 0}, {2, -1, 4}, {5, 0, 1}};
  std::vector<PathKey> keys;
  for (int i = 0; i < 4; ++i) keys.push_back({1.0 * i, pose(p[i], 0)});
  const double s = 0.3;
  const Eigen::Vector3d expected =
      0.5 * (2 * p[1] + (p[2] - p[0]) * s + (2 * p[0] - 5 * p[1] + 4 * p[2] - p[3]) * s * s +
             (3 * p[1] - p[0] - 3 * p[2] + p[3]) * s * s * s);
  const Eigen::Vector3d found = interpolate_path(keys, 1 + s).world_from_camera.translation();
  EXPECT_NEAR((found - expected).norm(), 0, 1e-14);
}

// Rotations about several axes: through the keys, and with one velocity on both sides of a key.
TEST(CameraPath, TurnsSmoothlyThroughItsKeys) {
  std::vector<PathKey> keys;
  for (int i = 0; i < 5; ++i) {
    keys.push_back({0.8 * i + 0.1 * i * i});
    keys.back().world_from_camera.linear() =
        so3_exp(Eigen::Vector3d(0.3 * i, std::sin(1.0 * i), 0.2 * i * i));
  }
  const auto rotation = [&](double t_s) -> Eigen::Matrix3d {
    return interpolate_path(keys, t_s).world_from_camera.linear();
  };
  constexpr double kStep_s = 1e-6;
  for (int i = 1; i < 4; ++i) {
    const double t_s = keys[i].t_s;
    const Eigen::Matrix3d at = rotation(t_s);
    EXPECT_EQ(at, keys[i].world_from_camera.linear());
    const Eigen::Vector3d before = so3_log(rotation(t_s - kStep_s).transpose() * at) / kStep_s,
                          after = so3_log(at.transpose() * rotation(t_s + kStep_s)) / kStep_s;
    EXPECT_NEAR((before - after).norm(), 0, 1e-4) << "at key " << i;
    EXPECT_GT(after.norm(), 0.1);
  }
}

TEST(CameraPath, StandsStillBeyondItsEnds) {
  const std::vector<PathKey> keys = {accelerated(1), accelerated(2)};
  expect_same(interpolate_path(keys, 0), keys[0], 0);
  expect_same(interpolate_path(keys, 9), keys[1], 0);
  expect_same(interpolate_path({keys[1]}, 0), keys[1], 0);
  const Eigen::Vector3d middle = interpolate_path(keys, 1.5).world_from_camera.translation();
  EXPECT_TRUE(middle.isApprox(
      0.5 * (keys[0].world_from_camera.translation() + keys[1].world_from_camera.translation())));
}

TEST(CameraPath, SpreadsItsImagesFromTheFirstKeyToTheLast) {
  CameraPath path;
  path.keys = {accelerated(1), accelerated(2), accelerated(4)};
  path.fps = 10;
  path.seconds = 0.7;
  EXPECT_EQ(path.images(), 7);
  EXPECT_EQ(path.at_image(0).t_s, 1);
  EXPECT_EQ(path.at_image(6).t_s, 4);
  EXPECT_NEAR(path.at_image(2).t_s, 2, 1e-15);
  path.seconds = 0;
  EXPECT_EQ(path.images(), 1);
  EXPECT_EQ(path.at_image(0).t_s, 1);
}

class PathOfARun : public testing::Test {
 protected:
  PathOfARun() {
    RigCamera camera;
    camera.name = "CAM";
    camera.body_from_sensor = Rigid3d::Identity();
    camera.body_from_sensor.translation() = Eigen::Vector3d(2, 0, 1.5);
    scene.rig = {camera};
    scene.global_from_world = Rigid3d::Identity();
    for (int i = 0; i < 3; ++i) {
      Rigid3d body = Rigid3d::Identity();
      body.translation() = Eigen::Vector3d(10 * i, 0, 0);
      scene.add_frame({20 + i, i * 500'000'000LL, body});
    }
  }
  Scene scene;
};

TEST_F(PathOfARun, FollowsTheDriveBesideIt) {
  const CameraPath path = drive_path(scene, scene.rig[0], 1.5);
  EXPECT_EQ(path.camera, "CAM");
  EXPECT_EQ(path.seconds, 1);
  EXPECT_EQ(path.images(), 24);
  EXPECT_TRUE(
      path.at_image(0).world_from_camera.translation().isApprox(Eigen::Vector3d(2, 1.5, 1.5)));
  EXPECT_TRUE(
      path.at_image(23).world_from_camera.translation().isApprox(Eigen::Vector3d(22, 1.5, 1.5)));
  EXPECT_EQ(path_exposure(path, scene, 0).t_s, 0.5f) << "the frame in the middle";
}

TEST_F(PathOfARun, PlacesKeyframesAsRenderDoes) {
  CameraPathFile file;
  file.path = "path.json";
  file.seconds = 2;
  file.keyframes = {{0, "CAM", 20, {0, 0, 0}, 0, 0}, {2, "CAM", 22, {1, 2, 3}, 90, 0}};
  const CameraPath path = path_of_file(file, scene);
  EXPECT_EQ(path.images(), 48);
  EXPECT_EQ(path.camera, "CAM");
  const Rigid3d end = path.at_image(47).world_from_camera;
  EXPECT_TRUE(end.translation().isApprox(Eigen::Vector3d(23, 2, 4.5)));
  EXPECT_TRUE(end.linear().col(0).isApprox(Eigen::Vector3d::UnitY()));
  for (const bool bad_camera : {true, false}) {
    CameraPathFile bad = file;
    if (bad_camera)
      bad.keyframes[1].camera = "OTHER";
    else
      bad.keyframes[1].frame_id = 5;
    try {
      path_of_file(bad, scene);
      FAIL();
    } catch (const InputError& error) {
      EXPECT_THAT(error.what(),
                  testing::StartsWith(bad_camera ? "path.json: keyframes[1].camera = OTHER"
                                                 : "path.json: keyframes[1].frame_id = 5"));
    }
  }
}

TEST_F(PathOfARun, TakesLensAndTimesOfAFile) {
  CameraPathFile file;
  file.width = 641;
  file.height = 361;
  file.fps = 10;
  file.seconds = 0.3;
  for (int i = 0; i < 3; ++i) file.cameras.push_back({pose({i * i * 1.0, 0, 0}, 0), 50.0 + i});
  const CameraPath path = path_of_file(file, scene);
  ASSERT_EQ(path.images(), 3);
  for (int i = 0; i < 3; ++i) {
    EXPECT_EQ(path.at_image(i).fov_deg, 50 + i);
    EXPECT_EQ(path.at_image(i).world_from_camera.translation().x(), i * i);
  }
  ASSERT_TRUE(path.lens);
  const Camera lens = with_fov(*path.lens, 50);
  // The upper edge, half a pixel above the first row, is half of the field of view off the axis.
  const auto edge = lens.unproject({320, -0.5});
  ASSERT_TRUE(edge);
  EXPECT_NEAR(std::atan2(-edge->y(), edge->z()), 25 * M_PI / 180, 1e-12);
  EXPECT_NEAR(edge->x(), 0, 1e-12);
}

}  // namespace
}  // namespace redrive
