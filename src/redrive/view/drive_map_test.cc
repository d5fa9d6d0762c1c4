// SPDX-License-Identifier: Apache-2.0
#include "redrive/view/drive_map.h"

#include <cmath>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace redrive::view {
namespace {

using Eigen::Vector3d;

/// Three bodies along x, 1 m apart, with a camera half a metre to the left and one to the right.
Scene three_frames() {
  Scene scene;
  for (int i = 0; i < 3; ++i) {
    Rigid3d pose = Rigid3d::Identity();
    pose.translation() = Vector3d(i, 0, 0);
    scene.add_frame({i, 100'000'000ll * i, pose});
  }
  for (const double y : {0.5, -0.5}) {
    RigCamera camera;
    camera.name = y > 0 ? "LEFT" : "RIGHT";
    camera.body_from_sensor = Rigid3d::Identity();
    camera.body_from_sensor.linear() << 0, 0, 1, -1, 0, 0, 0, -1, 0;  // looks along x
    camera.body_from_sensor.translation() = Vector3d(0, y, 1);
    scene.rig.push_back(camera);
  }
  return scene;
}

TEST(DriveMap, MeasuresFromTheCamerasOwnWay) {
  const DriveMap map(three_frames());
  EXPECT_NEAR(map.beside("LEFT", {0.5, 0.5, 1}), 0, 1e-12) << "between two frames";
  EXPECT_NEAR(map.beside("LEFT", {1.3, 2.5, 1}), 2, 1e-12);
  EXPECT_NEAR(map.beside("RIGHT", {1.3, 2.5, 1}), 3, 1e-12);
  EXPECT_NEAR(map.beside("mount", {1.3, -2.5, 1}), 2, 1e-12) << "the nearest camera's";
  EXPECT_NEAR(map.beside("LEFT", {5, 0.5, 1}), 3, 1e-12) << "beyond its end";
}

TEST(DriveMap, OfPhotographsFromTheNearestOne) {
  Scene scene = three_frames();
  scene.metric = false;
  const DriveMap map(scene);
  EXPECT_NEAR(map.beside("LEFT", {0.5, 0.5, 1}), 0.5, 1e-12);
}

TEST(DriveMap, IsSeenFromAbove) {
  const Scene scene = three_frames();
  const DriveMap map(scene);
  EXPECT_EQ(map.frames(), (nlohmann::json{{0, 0}, {1, 0}, {2, 0}}));
  const nlohmann::json at =
      map.place(scene.world_from_body(scene.frames[2].t_ns) * scene.rig[0].body_from_sensor);
  EXPECT_EQ(at, (nlohmann::json{2, 0.5, 1, 0}));
}

}  // namespace
}  // namespace redrive::view
