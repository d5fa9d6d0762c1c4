// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/bundle/ground_mesh.h"

#include <cmath>
#include <map>
#include <utility>

namespace redrive {
namespace {

constexpr double kLeastUp = 0.8, kHeight_m = 0.3, kHeightPerMetre = 0.05;
constexpr double kCell_m = 1;
// A square metre at the mesh's usual voxels.
constexpr std::size_t kLeastPiece = 50;

using Cell = std::pair<int, int>;

Cell cell_of(const Eigen::Vector3d& point) {
  return {static_cast<int>(std::floor(point.x() / kCell_m)),
          static_cast<int>(std::floor(point.y() / kCell_m))};
}

/// Returns the pose nearest to each cell of the plane that is in reach of one.
std::map<Cell, std::size_t> nearest_poses(std::span<const Rigid3d> driven) {
  constexpr int kReach = static_cast<int>(kGroundReach_m / kCell_m);
  struct Nearest {
    double squared = 0;
    std::size_t pose = 0;
  };
  std::map<Cell, Nearest> nearest;
  for (std::size_t i = 0; i < driven.size(); ++i) {
    const auto [x0, y0] = cell_of(driven[i].translation());
    for (int x = -kReach; x <= kReach; ++x)
      for (int y = -kReach; y <= kReach; ++y) {
        if (x * x + y * y > kReach * kReach) continue;
        const Eigen::Vector2d centre(kCell_m * (x0 + x + 0.5), kCell_m * (y0 + y + 0.5));
        const double squared = (centre - driven[i].translation().head<2>()).squaredNorm();
        const auto [entry, is_new] = nearest.try_emplace({x0 + x, y0 + y}, Nearest{squared, i});
        if (!is_new && squared < entry->second.squared) entry->second = {squared, i};
      }
  }
  std::map<Cell, std::size_t> out;
  for (const auto& [cell, found] : nearest) out[cell] = found.pose;
  return out;
}

}  // namespace

TriangleMesh ground_of_mesh(const TriangleMesh& mesh, std::span<const Rigid3d> driven) {
  const std::map<Cell, std::size_t> nearest = nearest_poses(driven);
  TriangleMesh ground{mesh.vertices, {}};
  for (const Triangle& triangle : mesh.triangles) {
    Eigen::Vector3d at[3];
    for (int k = 0; k < 3; ++k) at[k] = mesh.vertices[triangle[k]].position.cast<double>();
    const Eigen::Vector3d centre = (at[0] + at[1] + at[2]) / 3,
                          normal = (at[1] - at[0]).cross(at[2] - at[0]);
    const auto found = nearest.find(cell_of(centre));
    if (found == nearest.end()) continue;
    const Rigid3d& body = driven[found->second];
    const Eigen::Vector3d from = centre - body.translation();
    if (normal.dot(body.linear().col(2)) >= kLeastUp * normal.norm() &&
        std::abs(from.dot(body.linear().col(2))) <= kHeight_m + kHeightPerMetre * from.norm())
      ground.triangles.push_back(triangle);
  }
  remove_small_pieces(kLeastPiece, &ground);
  return ground;
}

}  // namespace redrive
