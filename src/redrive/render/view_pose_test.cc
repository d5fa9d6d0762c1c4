// SPDX-License-Identifier: Apache-2.0
#include "redrive/render/view_pose.h"

#include <cmath>

#include <gtest/gtest.h>

#include "redrive/base/error.h"

namespace redrive {
namespace {

// On the equator at longitude 0: up is ECEF x, east is y, north is z. The body heads east.
Rigid3d heading_east(double pitch_rad) {
  Rigid3d global_from_body = Rigid3d::Identity();
  Eigen::Matrix3d axes;  // columns: body x (east), y (left: north), z (up)
  axes.col(0) = Eigen::Vector3d::UnitY();
  axes.col(1) = Eigen::Vector3d::UnitZ();
  axes.col(2) = Eigen::Vector3d::UnitX();
  global_from_body.linear() = axes * Eigen::AngleAxisd(pitch_rad, Eigen::Vector3d::UnitY());
  global_from_body.translation() = Eigen::Vector3d(6378137.0, 0, 0);
  return global_from_body;
}

// The camera looks along body x: x right = -y, y down = -z, z forward = x; 2 m ahead, 1.5 m up.
Rigid3d front_camera() {
  Rigid3d body_from_sensor = Rigid3d::Identity();
  Eigen::Matrix3d axes;
  axes.col(0) = -Eigen::Vector3d::UnitY();
  axes.col(1) = -Eigen::Vector3d::UnitZ();
  axes.col(2) = Eigen::Vector3d::UnitX();
  body_from_sensor.linear() = axes;
  body_from_sensor.translation() = Eigen::Vector3d(2, 0, 1.5);
  return body_from_sensor;
}

Eigen::Vector3d shift_in_world(const Rigid3d& global_from_world, const Rigid3d& world_from_body,
                               ShiftAxes axes, const Eigen::Vector3d& shift) {
  const Rigid3d from = world_from_body * front_camera();
  const Rigid3d to =
      shifted_camera(global_from_world, world_from_body, front_camera(), axes, shift);
  EXPECT_TRUE(to.linear().isApprox(from.linear(), 1e-15)) << "the orientation stays";
  return to.translation() - from.translation();
}

constexpr double kTolerance_m = 1e-8;  // 6.4e6 m in double: one ulp is 9e-10 m

TEST(ViewPose, ShiftsAlongNamedAxes) {
  const Rigid3d level = heading_east(0),
                identity = Rigid3d::Identity();  // world = body of the first frame
  const Eigen::Vector3d shift(0.5, 0.25, -1);
  EXPECT_NEAR((shift_in_world(level, identity, ShiftAxes::kBody, shift) - shift).norm(), 0,
              kTolerance_m);
  // camera x right, y down, z forward, in body axes:
  EXPECT_NEAR((shift_in_world(level, identity, ShiftAxes::kCamera, shift) -
               Eigen::Vector3d(-1, -0.5, -0.25))
                  .norm(),
              0, kTolerance_m);
  EXPECT_NEAR((shift_in_world(level, identity, ShiftAxes::kLocal, shift) - shift).norm(), 0,
              kTolerance_m);
}

TEST(ViewPose, LocalAxesAreLevelOnASlope) {
  const double pitch = 0.1;  // a turn about y (left) by +0.1 rad lowers the nose
  const Rigid3d global_from_world = heading_east(pitch);
  const Eigen::Vector3d up = shift_in_world(global_from_world, Rigid3d::Identity(),
                                            ShiftAxes::kLocal, Eigen::Vector3d::UnitZ());
  EXPECT_NEAR((up - Eigen::Vector3d(-std::sin(pitch), 0, std::cos(pitch))).norm(), 0, kTolerance_m);
  const Eigen::Vector3d ahead = shift_in_world(global_from_world, Rigid3d::Identity(),
                                               ShiftAxes::kLocal, Eigen::Vector3d::UnitX());
  EXPECT_NEAR((ahead - Eigen::Vector3d(std::cos(pitch), 0, std::sin(pitch))).norm(), 0,
              kTolerance_m);
  const Eigen::Vector3d left = shift_in_world(global_from_world, Rigid3d::Identity(),
                                              ShiftAxes::kLocal, Eigen::Vector3d::UnitY());
  EXPECT_NEAR((left - Eigen::Vector3d::UnitY()).norm(), 0, kTolerance_m);
}

TEST(ViewPose, UpIsTheNormalOfTheEllipsoid) {
  // Geodetic latitude phi, longitude 0, height 0: the normal is (cos phi, 0, sin phi), the point
  // N (cos phi, 0, (1 - e^2) sin phi) with N = a / sqrt(1 - e^2 sin^2 phi) (WGS84).
  const double a = 6378137.0, f = 1 / 298.257223563, e2 = f * (2 - f), phi = 0.8;
  const double n = a / std::sqrt(1 - e2 * std::sin(phi) * std::sin(phi));
  Rigid3d global_from_body = Rigid3d::Identity();
  global_from_body.linear().col(0) = Eigen::Vector3d::UnitY();  // east
  global_from_body.linear().col(1) = Eigen::Vector3d(-std::sin(phi), 0, std::cos(phi));
  global_from_body.linear().col(2) = Eigen::Vector3d(std::cos(phi), 0, std::sin(phi));
  global_from_body.translation() =
      Eigen::Vector3d(n * std::cos(phi), 0, n * (1 - e2) * std::sin(phi));
  const auto axes = world_from_local_axes(global_from_body, Rigid3d::Identity());
  ASSERT_TRUE(axes);
  EXPECT_NEAR((*axes - Eigen::Matrix3d::Identity()).norm(), 0,
              1e-11);  // b is rounded to 1e-6 m of 6.4e6 m
}

TEST(ViewPose, HasNoLocalAxesOffTheEarth) {
  EXPECT_FALSE(world_from_local_axes(Rigid3d::Identity(), Rigid3d::Identity()));
  EXPECT_FALSE(world_from_local_axes(heading_east(std::acos(-1.0) / 2), Rigid3d::Identity()))
      << "heading straight down";
  EXPECT_THROW(shifted_camera(Rigid3d::Identity(), Rigid3d::Identity(), front_camera(),
                              ShiftAxes::kLocal, {0, 0, 0}),
               UsageError);
}

class Requested : public testing::Test {
 protected:
  Requested() {
    scene.global_from_world = heading_east(0);
    Rigid3d second = scene.global_from_world;
    second.translate(Eigen::Vector3d(3, 0, 0));
    scene.rig = {{"CAM", {}, {}, Rigid3d::Identity()}};
    scene.trajectory = {{10, 0, scene.global_from_world}, {11, 100, second}};
  }
  Eigen::Vector3d position(RequestedView view, bool prefer_shift = false) {
    ViewRequests poses;
    poses.path = "poses.json";
    poses.cameras = cameras;
    poses.views = {std::move(view)};
    const std::vector<RigCamera> rig = poses_rig(poses, scene, false);
    return requested_world_from_body(poses, 0, requested_camera(poses, 0, rig), scene, prefer_shift)
        .translation();
  }
  Scene scene;
  std::vector<CameraCalibration> cameras;  // cameras of the poses file
};

TEST_F(Requested, PrefersAbsolutePosesUnlessAskedForShifts) {
  RequestedView shift{"a.png", "CAM", 11, std::nullopt, Eigen::Vector3d(0, 1, 0)};
  EXPECT_NEAR((position(shift) - Eigen::Vector3d(3, 1, 0)).norm(), 0, kTolerance_m);
  RequestedView both = shift;
  both.global_from_body = scene.global_from_world * Eigen::Translation3d(7, 0, 0);
  EXPECT_NEAR((position(both) - Eigen::Vector3d(7, 0, 0)).norm(), 0, kTolerance_m);
  EXPECT_NEAR((position(both, true) - Eigen::Vector3d(3, 1, 0)).norm(), 0, kTolerance_m);
  RequestedView absolute = both;
  absolute.shift_body_m.reset();
  EXPECT_NEAR((position(absolute, true) - Eigen::Vector3d(7, 0, 0)).norm(), 0, kTolerance_m);
  absolute.frame_id = 99;  // an absolute pose needs no frame
  EXPECT_NEAR((position(absolute) - Eigen::Vector3d(7, 0, 0)).norm(), 0, kTolerance_m);
}

// A camera of the run that exposes a quarter of a frame late has the pose of that time; an absolute
// pose is kept.
TEST_F(Requested, ShiftsThePoseOfTheCamerasOwnExposure) {
  scene.rig[0].time_offset_ns = 25;
  RequestedView view{"a.png", "CAM", 10, std::nullopt, Eigen::Vector3d(0, 1, 0)};
  EXPECT_NEAR((position(view) - Eigen::Vector3d(0.75, 1, 0)).norm(), 0, kTolerance_m);
  view.global_from_body = scene.global_from_world;
  EXPECT_NEAR(position(view).norm(), 0, kTolerance_m);
}

// The file's calibration replaces the run's entirely: its offset counts, not the offset of the
// run's camera of this name.
TEST_F(Requested, UsesTheTimeOffsetOfThePosesFilesCamera) {
  scene.rig[0].time_offset_ns = 25;
  cameras.emplace_back();
  cameras[0].name = "CAM";
  cameras[0].model = "opencv_pinhole";
  cameras[0].parameters = {8, 8, 0, 0, 0, 0, 0, 0, 0};
  cameras[0].width = cameras[0].height = 8;
  cameras[0].body_from_sensor = Rigid3d::Identity();
  const RequestedView view{"a.png", "CAM", 10, std::nullopt, Eigen::Vector3d(0, 1, 0)};
  EXPECT_NEAR((position(view) - Eigen::Vector3d(0, 1, 0)).norm(), 0, kTolerance_m)
      << "without an offset";
  cameras[0].time_offset_ns = 50;
  EXPECT_NEAR((position(view) - Eigen::Vector3d(1.5, 1, 0)).norm(), 0, kTolerance_m);
}

TEST(TurnedSensor, TurnsToTheLeftAndUp) {
  Rigid3d front = Rigid3d::Identity();  // looks along body x: right is -y, down is -z
  front.linear() << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  front.translation() = Eigen::Vector3d(2, 0.1, 1.2);
  const double angle_rad = 0.3, c = std::cos(angle_rad), s = std::sin(angle_rad);
  const Rigid3d left = turned_sensor(front, angle_rad, 0), up = turned_sensor(front, 0, angle_rad),
                both = turned_sensor(front, M_PI / 2, angle_rad);
  EXPECT_NEAR((left.linear().col(2) - Eigen::Vector3d(c, s, 0)).norm(), 0, 1e-15);
  EXPECT_NEAR((up.linear().col(2) - Eigen::Vector3d(c, 0, s)).norm(), 0, 1e-15);
  EXPECT_NEAR((both.linear().col(2) - Eigen::Vector3d(0, c, s)).norm(), 0, 1e-15);
  for (const Rigid3d& turned : {left, up, both})
    EXPECT_EQ(turned.translation(), front.translation());
  EXPECT_EQ(turned_sensor(front, 0, 0).matrix(), front.matrix());
}

TEST_F(Requested, ErrorsNameFileFieldAndValue) {
  try {
    position({"a.png", "CAM", 12, std::nullopt, Eigen::Vector3d::Zero()});
    FAIL() << "an unknown frame was taken";
  } catch (const InputError& error) {
    EXPECT_NE(std::string(error.what()).find("poses.json: images[0].frame_id = 12"),
              std::string::npos)
        << error.what();
  }
  ViewRequests poses;
  poses.path = "poses.json";
  poses.views = {{"a.png", "NO_CAM", 10, std::nullopt, Eigen::Vector3d::Zero()}};
  const std::vector<RigCamera> rig = {{"F_CAM", {}, {}, front_camera()},
                                      {"B_CAM", {}, {}, front_camera()}};
  try {
    requested_camera(poses, 0, rig);
    FAIL() << "an unknown camera was taken";
  } catch (const InputError& error) {
    EXPECT_NE(std::string(error.what()).find("images[0].camera = NO_CAM"), std::string::npos)
        << error.what();
    EXPECT_NE(std::string(error.what()).find("F_CAM, B_CAM"), std::string::npos) << error.what();
  }
}

}  // namespace
}  // namespace redrive
