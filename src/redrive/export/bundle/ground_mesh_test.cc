// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/bundle/ground_mesh.h"

#include <cmath>
#include <vector>

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

// A road that rises by a tenth and has no surface before x = 4 and between 8 and 10.
TEST(GroundMesh, IsFilledUnderTheBody) {
  const Eigen::Vector3f y = Eigen::Vector3f::UnitY(), slope(1, 0, 0.1f);
  TriangleMesh ground;
  add_grid({4, -2, 0.43f}, slope / 4, y / 4, 16, &ground);
  add_grid({10, -2, 1.03f}, slope / 4, y / 4, 16, &ground);
  const std::size_t before = ground.triangles.size();
  std::vector<Rigid3d> driven;
  for (int i = 0; i <= 12; ++i) {
    Rigid3d body = Rigid3d::Identity();
    body.linear() = Eigen::AngleAxisd(-std::atan(0.1), Eigen::Vector3d::UnitY()).matrix();
    body.translation() = Eigen::Vector3d(i, 0, 0.1 * i);
    driven.push_back(body);
  }
  const std::size_t added = fill_under_body(driven, &ground);
  EXPECT_EQ(ground.triangles.size(), before + added);
  // Eight metres along and three across, and half a disc at each end.
  EXPECT_NEAR(added * 0.125, 8 * 3 + 3.1416 * 1.5 * 1.5, 1.5);
  for (std::size_t i = before; i < ground.triangles.size(); ++i) {
    Eigen::Vector3f at[3];
    for (int k = 0; k < 3; ++k) at[k] = ground.vertices[ground.triangles[i][k]].position;
    EXPECT_GT((at[1] - at[0]).cross(at[2] - at[0]).z(), 0) << "faces up";
    for (const Eigen::Vector3f& p : at) {
      // On the wheels' plane far behind the surface, and level with it beside it.
      const double above = p.z() - 0.1 * p.x();
      EXPECT_GE(above, -1e-5);
      EXPECT_LE(above, 0.03 + 1e-5);
      EXPECT_NEAR(above, p.x() < 1 ? 0 : p.x() > 7.9 ? 0.03 : above, 1e-5);
    }
  }
  TriangleMesh none;
  EXPECT_EQ(fill_under_body({}, &none), 0u);
}

}  // namespace
}  // namespace redrive
