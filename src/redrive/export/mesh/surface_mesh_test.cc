// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/mesh/surface_mesh.h"

#include <map>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/export/mesh/surfaces_testing.h"

namespace redrive {
namespace {

constexpr double kRadius_m = 1;

// The half of positive x is red, the other blue.
std::optional<SurfaceHit> ball(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction) {
  const double b = origin.dot(direction),
               discriminant = b * b - origin.squaredNorm() + kRadius_m * kRadius_m;
  if (discriminant < 0) return std::nullopt;
  const double depth = -b - std::sqrt(discriminant);
  const Eigen::Vector3d at = origin + depth * direction;
  return SurfaceHit{depth, at.normalized(),
                    at.x() > 0 ? std::array<std::uint8_t, 3>{200, 20, 20}
                               : std::array<std::uint8_t, 3>{20, 20, 200}};
}

std::vector<DepthImage> images_around_the_ball() {
  std::vector<DepthImage> images;
  const Camera camera = right_angle_camera(200);
  for (int x = -1; x <= 1; ++x)
    for (int y = -1; y <= 1; ++y)
      for (int z = -1; z <= 1; ++z)
        if (x != 0 || y != 0 || z != 0) {
          const Eigen::Vector3d from = 3 * Eigen::Vector3d(x, y, z).normalized();
          images.push_back(see(ball, camera, looking(from, -from)));
        }
  return images;
}

/// The number of triangles on the side of each directed edge.
std::map<std::pair<std::uint32_t, std::uint32_t>, int> directed_edges(const TriangleMesh& mesh) {
  std::map<std::pair<std::uint32_t, std::uint32_t>, int> edges;
  for (const Triangle& t : mesh.triangles)
    for (int k = 0; k < 3; ++k) ++edges[{t[k], t[(k + 1) % 3]}];
  return edges;
}

class SurfaceMesh : public ::testing::Test {
 protected:
  void SetUp() override {
    if (const auto obstacle = mesh_obstacle()) GTEST_SKIP() << *obstacle;
  }
  ThreadPool pool_{2};
};

TEST_F(SurfaceMesh, OfABallIsClosedAndWithinHalfAVoxel) {
  constexpr double kVoxel_m = 0.1;
  TsdfVolume volume(kVoxel_m, kAmpleMemory);
  volume.fuse(images_around_the_ball(), 10, pool_);
  const TriangleMesh mesh = surface_mesh(volume, 100, pool_);
  ASSERT_GT(mesh.triangles.size(), 1000u) << "4 pi 100 faces of voxels";
  double error_m = 0;
  for (const PlyPoint& vertex : mesh.vertices) {
    error_m = std::max(error_m, std::abs(static_cast<double>(vertex.position.norm()) - kRadius_m));
    EXPECT_GT(vertex.normal.dot(vertex.position.normalized()), 0.9f) << "outwards";
    if (std::abs(vertex.position.x()) < 3 * kVoxel_m) continue;
    const std::size_t bright = vertex.position.x() > 0 ? 0 : 2;
    EXPECT_NEAR(vertex.rgb[bright], 200, 20);
    EXPECT_NEAR(vertex.rgb[2 - bright], 20, 20);
  }
  EXPECT_LT(error_m, 0.5 * kVoxel_m);
  const auto edges = directed_edges(mesh);
  for (const auto& [edge, n] : edges) {
    ASSERT_EQ(n, 1);
    ASSERT_TRUE(edges.contains({edge.second, edge.first})) << "a hole";
  }
  EXPECT_EQ(mesh.vertices.size() + mesh.triangles.size(), edges.size() / 2 + 2) << "Euler: a ball";
}

TEST_F(SurfaceMesh, DoesNotDependOnTheNumberOfThreads) {
  TsdfVolume one(0.2, kAmpleMemory), two(0.2, kAmpleMemory);
  const std::vector<DepthImage> images = images_around_the_ball();
  ThreadPool single(1);
  one.fuse(images, 10, single);
  two.fuse(images, 10, pool_);
  const TriangleMesh a = surface_mesh(one, 1, single), b = surface_mesh(two, 1, pool_);
  EXPECT_EQ(make_obj(a), make_obj(b));
}

// A camera 0.75 m above the ground that drives and sees it ever more steeply, with a rolling
// shutter.
TEST_F(SurfaceMesh, OfTheGroundIsFlatUpToGrazingViews) {
  constexpr double kVoxel_m = 0.1;
  std::vector<DepthImage> images;
  const Surface ground = ground_surface([](double, double) { return true; });
  for (int n = 0; n < 5; ++n) {
    const auto pose = [&](double x) { return looking({x, 0, 0.75}, {1, 0, 0}); };
    images.push_back(see(ground, right_angle_camera(100),
                         ShutterPoses(std::vector<Rigid3d>{pose(n), pose(n + 0.5)})));
  }
  TsdfVolume volume(kVoxel_m, kAmpleMemory);
  volume.fuse(images, 10, pool_);
  const TriangleMesh mesh = surface_mesh(volume, 100, pool_);
  double area_m2 = 0;
  for (const Triangle& t : mesh.triangles) {
    const Eigen::Vector3f &a = mesh.vertices[t[0]].position, &b = mesh.vertices[t[1]].position,
                          &c = mesh.vertices[t[2]].position;
    if (a.x() > 3 && a.x() < 10 && std::abs(a.y()) < 3)
      area_m2 += 0.5 * static_cast<double>((b - a).cross(c - a).z());
  }
  EXPECT_NEAR(area_m2, 7 * 6, 1) << "without holes";
  for (const PlyPoint& vertex : mesh.vertices) EXPECT_NEAR(vertex.position.z(), 0, 0.5 * kVoxel_m);
}

TEST_F(SurfaceMesh, RefusesMoreThanTheMemoryAllows) {
  TsdfVolume volume(0.02, 10'000'000);
  try {
    volume.fuse(images_around_the_ball(), 10, pool_);
    FAIL() << "10 MB were enough";
  } catch (const UsageError& error) {
    EXPECT_THAT(error.what(), ::testing::HasSubstr("--voxel"));
  }
  EXPECT_LE(volume.blocks().size() * sizeof(TsdfBlock), 10'000'000u);
}

}  // namespace
}  // namespace redrive
