// SPDX-License-Identifier: Apache-2.0
#include "redrive/edit/object_summary.h"

#include <gtest/gtest.h>

namespace redrive {
namespace {

/// A camera at the origin looks along x; a car drives 10 m across at 20 m, one is parked behind.
TEST(ObjectSummary, CountsBoxesImagesAndMetres) {
  Scene scene;
  RigCamera camera;
  camera.name = "CAMERA";
  camera.camera = make_camera({"CAMERA",
                               "opencv_pinhole",
                               {100, 100, 49.5, 29.5, 0, 0, 0, 0, 0},
                               100,
                               60,
                               Rigid3d::Identity()});
  Rigid3d looking = Rigid3d::Identity();
  looking.linear() << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  camera.body_from_sensor = looking;
  scene.rig.push_back(camera);
  std::vector<FramePose> frames;
  std::vector<Box> boxes;
  for (int i = 0; i < 11; ++i) {
    scene.add_frame({i, 100'000'000ll * i, Rigid3d::Identity()});
    frames.push_back({i, 100'000'000ll * i, Rigid3d::Identity()});
    View view;
    view.frame = i;
    scene.views.push_back(view);
    for (const std::int64_t id : {5, 2}) {
      Box box;
      box.object_id = id;
      box.type = id == 5 ? "CAR" : "VAN";
      box.t_ns = 100'000'000ll * i;
      box.body_from_box = Rigid3d::Identity();
      box.body_from_box.translation() = id == 5 ? Eigen::Vector3d(20, 14.5 - i, 0)  // out at 9.9 m
                                                : Eigen::Vector3d(-7, 0, 0);
      box.size_m = Eigen::Vector3d(4, 2, 1.5);
      if (id == 5) box.velocity_in_body_m_per_s = Eigen::Vector3d(0, -10, 0);
      boxes.push_back(box);
    }
  }
  const std::vector<ObjectSummary> found =
      summarize_objects(scene, MovingObjects(boxes, frames, Rigid3d::Identity()));
  ASSERT_EQ(found.size(), 2u);
  EXPECT_EQ(found[0].id, 2);
  EXPECT_FALSE(found[0].moves);
  EXPECT_EQ(found[0].images, 0u);
  EXPECT_NEAR(found[0].nearest_m, 7, 1e-9);
  EXPECT_EQ(found[1].type, "CAR");
  EXPECT_TRUE(found[1].moves);
  EXPECT_EQ(found[1].boxes, 11u);
  EXPECT_NEAR(found[1].driven_m, 10, 1e-9);
  EXPECT_NEAR(found[1].nearest_m, std::hypot(20, 4.5), 1e-9);
  EXPECT_EQ(found[1].images, 6u);
}

}  // namespace
}  // namespace redrive
