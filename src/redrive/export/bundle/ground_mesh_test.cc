// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/bundle/ground_mesh.h"

#include <gtest/gtest.h>

namespace redrive {
namespace {

/// Adds a square grid of 1 m: corner + i a + j b for i, j in 0..n.
void add_grid(const Eigen::Vector3f& corner, const Eigen::Vector3f& a, const Eigen::Vector3f& b,
              std::uint32_t n, TriangleMesh* mesh) {
  const auto first = static_cast<std::uint32_t>(mesh->vertices.size());
  for (std::uint32_t i = 0; i <= n; ++i)
    for (std::uint32_t j = 0; j <= n; ++j)
      mesh->vertices.push_back(
          {corner + static_cast<float>(i) * a + static_cast<float>(j) * b, {}, {}});
  for (std::uint32_t i = 0; i < n; ++i)
    for (std::uint32_t j = 0; j < n; ++j) {
      const std::uint32_t at = first + i * (n + 1) + j;
      mesh->triangles.push_back({at, at + n + 1, at + 1});
      mesh->triangles.push_back({at + n + 1, at + n + 2, at + 1});
    }
}

TEST(GroundMesh, IsWhatACarDrivesOn) {
  const Eigen::Vector3f x = Eigen::Vector3f::UnitX(), y = Eigen::Vector3f::UnitY(),
                        z = Eigen::Vector3f::UnitZ(), slope(1, 0, 0.1f);
  TriangleMesh mesh;
  add_grid({-20, -20, -2}, slope, y, 40, &mesh);  // a road that rises by a tenth
  add_grid({-4, 3, 1.2f}, x, y, 8, &mesh);        // a roof
  add_grid({-4, -5, 0}, x, z, 8, &mesh);          // a wall
  add_grid({0, 5, 0}, y, x, 8, &mesh);            // a ceiling, from below
  Rigid3d body = Rigid3d::Identity();
  body.linear() = Eigen::AngleAxisd(-std::atan(0.1), Eigen::Vector3d::UnitY()).matrix();
  const TriangleMesh ground = ground_of_mesh(mesh, std::vector<Rigid3d>{body});
  ASSERT_GT(ground.triangles.size(), 1000u);
  EXPECT_LT(ground.triangles.size(), 2u * 31 * 31);
  for (const PlyPoint& vertex : ground.vertices) {
    EXPECT_NEAR(vertex.position.z(), 0.1 * vertex.position.x(), 1e-5);
    EXPECT_LE(vertex.position.head<2>().norm(), kGroundReach_m + 2.5);
  }
  EXPECT_TRUE(ground_of_mesh(mesh, {}).triangles.empty());
}

}  // namespace
}  // namespace redrive
