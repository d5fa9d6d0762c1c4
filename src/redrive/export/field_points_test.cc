// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/field_points.h"

#include <gtest/gtest.h>

#include "redrive/render/paint_backend_testing.h"
#include "redrive/scene/scene_testing.h"

namespace redrive {
namespace {

constexpr double kWall_m = 2;

// A wall 2 m ahead of the camera FRONT, of one colour.
TEST(FieldPoints, LieOnTheSurfaceAndFaceTheCamera) {
  TemporaryFolder folder;
  redrive::Run run;
  run.recording = make_test_recording(folder.path, 1);
  SceneOptions options;
  options.cameras = {"FRONT"};
  run.scene = make_scene(run.recording, options);
  run.scene.far_m = 10;
  run.state.model = make_painted_model();
  const Rigid3d world_from_camera = run.scene.world_from_camera(run.scene.views.at(0));
  const Eigen::Vector3d forward = world_from_camera.linear().col(2);
  PaintBackend backend(
      [](const auto&, const auto&) {
        return std::array<float, 3>{1, 0.2f, 0};
      },
      [&](const auto&, const std::array<float, 3>& direction) {
        const Eigen::Vector3d ray(direction[0], direction[1], direction[2]);
        return static_cast<float>(kWall_m / ray.dot(forward));
      });

  const std::vector<PlyPoint> points = field_points(run, backend, 1000);
  EXPECT_GT(points.size(), 300u) << "of 24 x 16 pixels";
  for (const PlyPoint& point : points) {
    const Eigen::Vector3d in_camera =
        world_from_camera.inverse(Eigen::Isometry) * point.position.cast<double>();
    EXPECT_NEAR(in_camera.z(), kWall_m, 1e-4);
    EXPECT_NEAR((point.normal.cast<double>() + forward).norm(), 0, 1e-2);
    EXPECT_EQ(point.rgb, (std::array<std::uint8_t, 3>{255, 51, 0}));
  }
  const std::size_t fewer = field_points(run, backend, 100).size();
  EXPECT_LE(fewer, 100u);
  EXPECT_GT(fewer, 50u);
  run.scene.far_m = 1;
  EXPECT_TRUE(field_points(run, backend, 1000).empty());
}

}  // namespace
}  // namespace redrive
