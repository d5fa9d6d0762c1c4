// SPDX-License-Identifier: Apache-2.0
// A real set of photographs; skipped where it is missing. The expected values are from its
// SOURCE.md.
#include <numbers>

#include <gtest/gtest.h>

#include "redrive/scene/load_views.h"

namespace redrive {
namespace {

TEST(Fox, OpensWithEveryEighthImageHeldOut) {
  const std::filesystem::path root = REDRIVE_SHARED "/data/fox";
  if (!std::filesystem::exists(root)) GTEST_SKIP() << root << " is not here";
  const Recording recording = open_recording(root);
  EXPECT_EQ(recording.format, "transforms");
  SceneOptions options;
  options.holdout_every = 8;
  const Scene scene = make_scene(recording, options);
  ASSERT_EQ(scene.rig.size(), 1u);
  ASSERT_EQ(scene.views.size(), 50u);
  EXPECT_EQ(scene.rig[0].camera.cx, 554.058);
  EXPECT_NEAR(*scene.half_side, 2 / 0.33, 1e-12);
  int held_out = 0;
  for (const View& view : scene.views) held_out += view.held_out;
  EXPECT_EQ(held_out, 7);
  EXPECT_TRUE(scene.views[0].held_out);
  EXPECT_EQ(scene.views[0].image.filename(), "0001.jpg");

  // The photographer walks around the fox in the middle with the camera upright.
  const Camera& camera = scene.rig[0].camera;
  for (const View& view : scene.views) {
    const Rigid3d world_from_camera = scene.world_from_camera(view);
    const auto middle = camera.project(world_from_camera.inverse() * Eigen::Vector3d::Zero());
    ASSERT_TRUE(middle) << view.image;
    EXPECT_TRUE(middle->x() > 0 && middle->x() < camera.width && middle->y() > 0 &&
                middle->y() < camera.height)
        << view.image << ' ' << middle->transpose();
    EXPECT_LT((world_from_camera.linear() * Eigen::Vector3d::UnitY()).z(), -0.8)
        << "its y axis points down";
    EXPECT_LT(world_from_camera.translation().norm(), *scene.half_side * std::numbers::sqrt3);
  }
  const Image8 image = load_view(scene, scene.views[49]);
  EXPECT_EQ(image.width, 1080);
  EXPECT_EQ(image.height, 1920);
}

}  // namespace
}  // namespace redrive
