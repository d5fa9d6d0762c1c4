// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/mesh/field_mesh.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/export/depth_image.h"
#include "redrive/export/mesh/surface_mesh.h"
#include "redrive/export/mesh/surfaces_testing.h"
#include "redrive/perception/masks.h"
#include "redrive/render/paint_backend_testing.h"
#include "redrive/scene/scene_testing.h"

namespace redrive {
namespace {

constexpr double kWallAt_m = 2;

/// A wall 2 m ahead of the camera FRONT, which sees 2.2 m x 1.6 m of it.
class FieldMeshTest : public ::testing::Test {
 protected:
  FieldMeshTest() {
    run_.recording = make_test_recording(folder_.path, 1);
    run_.paths.root = folder_.path / "run";
    std::filesystem::create_directories(run_.paths.masks());
    SceneOptions options;
    options.cameras = {"FRONT"};
    run_.scene = make_scene(run_.recording, options);
    run_.scene.far_m = 10;
    run_.state.model = make_painted_model();
    world_from_camera_ = run_.scene.world_from_camera(run_.scene.views.at(0));
  }
  void SetUp() override {
    if (const auto obstacle = mesh_obstacle()) GTEST_SKIP() << *obstacle;
  }

  FieldMesh mesh(double voxel_m, std::uint64_t most_bytes = kAmpleMemory) {
    const Eigen::Vector3d forward = world_from_camera_.linear().col(2);
    PaintBackend backend(
        [](const auto&, const auto&) {
          return std::array<float, 3>{1, 0.2f, 0};
        },
        [&](const auto&, const std::array<float, 3>& direction) {
          const Eigen::Vector3d ray(direction[0], direction[1], direction[2]);
          return static_cast<float>(kWallAt_m / ray.dot(forward));
        });
    return field_mesh(run_, backend, {voxel_m, most_bytes});
  }
  /// The area of the mesh.
  static double area_m2(const TriangleMesh& mesh) {
    double sum = 0;
    for (const Triangle& t : mesh.triangles) {
      const Eigen::Vector3f& a = mesh.vertices[t[0]].position;
      sum += 0.5 *
             static_cast<double>(
                 (mesh.vertices[t[1]].position - a).cross(mesh.vertices[t[2]].position - a).norm());
    }
    return sum;
  }

  TemporaryFolder folder_;
  redrive::Run run_;
  Rigid3d world_from_camera_;
};

TEST_F(FieldMeshTest, LiesOnTheSurfaceInMetres) {
  const FieldMesh field = mesh(0);
  EXPECT_EQ(field.images, 1);
  EXPECT_EQ(field.voxel_m, 0.1);
  EXPECT_EQ(field.range_m, 40);
  ASSERT_FALSE(field.mesh.triangles.empty());
  EXPECT_NEAR(area_m2(field.mesh), 2.2 * 1.6, 1.2) << "up to two voxels are lost at each edge";
  const Eigen::Vector3d forward = world_from_camera_.linear().col(2);
  for (const PlyPoint& vertex : field.mesh.vertices) {
    const Eigen::Vector3d in_camera =
        world_from_camera_.inverse(Eigen::Isometry) * vertex.position.cast<double>();
    EXPECT_NEAR(in_camera.z(), kWallAt_m, 0.01);
    EXPECT_LT((vertex.normal.cast<double>() + forward).norm(), 0.1);
    EXPECT_EQ(vertex.rgb, (std::array<std::uint8_t, 3>{255, 51, 0}));
  }
}

TEST_F(FieldMeshTest, LeavesMaskedPixelsOut) {
  const RigCamera& rig = run_.scene.rig[0];
  const double whole = area_m2(mesh(0.05).mesh);
  Mask mask = full_mask(rig.camera.width, rig.camera.height);
  for (std::size_t i = 0; i < mask.used.size() / 2; ++i) mask.used[i] = 0;
  write_masks(run_.paths.masks(), {mask}, run_.scene);
  const FieldMesh half = mesh(0.05);
  EXPECT_NEAR(area_m2(half.mesh) / whole, 0.5, 0.1);
}

TEST_F(FieldMeshTest, RefusesMoreThanTheMemoryAllows) {
  try {
    mesh(0.01, 2'000'000);
    FAIL() << "2 MB were enough";
  } catch (const UsageError& error) {
    EXPECT_THAT(error.what(), ::testing::HasSubstr("--voxel"));
  }
}

TEST_F(FieldMeshTest, IsEmptyWithoutSurfaces) {
  run_.scene.views.clear();
  EXPECT_TRUE(mesh(0).mesh.triangles.empty());
}

TEST(DepthImage, LeavesOutWhatIsNotOpaque) {
  const Camera camera = make_camera(
      {"TEST", "opencv_pinhole", {20, 20, 7.5, 7.5, 0, 0, 0, 0, 0}, 16, 16, Rigid3d::Identity()});
  const RayTable table = make_ray_table(camera);
  RenderedImage image{16,
                      16,
                      std::vector<float>(3 * 256, 0.5f),
                      std::vector<float>(256, 3.0f),
                      std::vector<float>(256, 1.0f),
                      std::vector<std::uint8_t>(256, 1)};
  image.opacity[3] = 0.89f;
  image.depth[5] = std::numeric_limits<float>::infinity();
  std::vector<std::uint8_t> used(256, 1);
  used[7] = 0;
  const DepthImage made =
      make_depth_image(image, table, pixel_directions(table), Rigid3d::Identity(), used);
  for (const std::size_t i : {3, 5, 7}) EXPECT_EQ(made.depth_m[i], 0) << i;
  EXPECT_EQ(made.depth_m[100], 3);
  EXPECT_EQ(made.rgb[100][1], 128);
  EXPECT_NEAR(made.normal_at(100).norm(), 1, 1e-9);
}

}  // namespace
}  // namespace redrive
