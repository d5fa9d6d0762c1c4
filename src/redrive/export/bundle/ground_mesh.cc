// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/bundle/ground_mesh.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <set>
#include <utility>
#include <vector>

#include <Eigen/Geometry>

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

/// A place on the driven line: its distance from a point of the plane, and the plane of the body.
struct Under {
  double squared = std::numeric_limits<double>::infinity();
  Eigen::Vector3d at = Eigen::Vector3d::Zero(), up = Eigen::Vector3d::UnitZ();

  double height_at(const Eigen::Vector2d& point) const {
    return at.z() - (point - at.head<2>()).dot(up.head<2>()) / up.z();
  }
};

/// The driven line by its stretches from pose to pose.
class DrivenLine {
 public:
  explicit DrivenLine(std::span<const Rigid3d> driven) {
    constexpr double kApart_m = 0.2;
    for (const Rigid3d& pose : driven)
      if (poses_.empty() ||
          (pose.translation() - poses_.back().translation()).head<2>().norm() >= kApart_m)
        poses_.push_back(pose);
    if (poses_.empty()) return;
    Rigid3d before = poses_.front(), after = poses_.back();
    before.translation() -= kBeyondEnds_m * before.linear().col(0);
    after.translation() += kBeyondEnds_m * after.linear().col(0);
    poses_.insert(poses_.begin(), before);
    poses_.push_back(after);
  }

  std::size_t stretches() const { return poses_.empty() ? 0 : poses_.size() - 1; }
  Eigen::Vector2d begin_of(std::size_t i) const { return poses_[i].translation().head<2>(); }
  Eigen::Vector2d end_of(std::size_t i) const { return begin_of(i + 1); }

  /// The place of stretch i that is nearest to a point.
  Under nearest(std::size_t i, const Eigen::Vector2d& point) const {
    const Eigen::Vector2d along = end_of(i) - begin_of(i);
    const double share =
        std::clamp((point - begin_of(i)).dot(along) / along.squaredNorm(), 0.0, 1.0);
    const auto between = [&](const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
      return Eigen::Vector3d(a + share * (b - a));
    };
    Under under;
    under.at = between(poses_[i].translation(), poses_[i + 1].translation());
    under.up = between(poses_[i].linear().col(2), poses_[i + 1].linear().col(2));
    under.squared = (point - under.at.head<2>()).squaredNorm();
    return under;
  }

 private:
  std::vector<Rigid3d> poses_;
};

constexpr double kSquare_m = 0.5;
using Square = std::pair<int, int>;  ///< a square of the plane, or its lowest corner

Square square_of(const Eigen::Vector2d& point) {
  return {static_cast<int>(std::floor(point.x() / kSquare_m)),
          static_cast<int>(std::floor(point.y() / kSquare_m))};
}
Eigen::Vector2d corner_of(const Square& square) {
  return kSquare_m * Eigen::Vector2d(square.first, square.second);
}

/// Calls use(square, nearest place) for squares whose point lies within `reach_m` of a stretch.
/// `in_square`: the point, from the square's corner.
template <class Use>
void each_near(const DrivenLine& line, double reach_m, const Eigen::Vector2d& in_square,
               const Use& use) {
  constexpr double kLongest_m = 20;  // nobody knows what lies in longer gaps
  const Eigen::Vector2d margin = Eigen::Vector2d::Constant(reach_m);
  for (std::size_t i = 0; i < line.stretches(); ++i) {
    const Eigen::Vector2d a = line.begin_of(i), b = line.end_of(i);
    if ((b - a).norm() > kLongest_m) continue;
    const Square low = square_of(a.cwiseMin(b) - margin), high = square_of(a.cwiseMax(b) + margin);
    for (int x = low.first; x <= high.first; ++x)
      for (int y = low.second; y <= high.second; ++y) {
        const Under under = line.nearest(i, corner_of({x, y}) + in_square);
        if (under.squared <= reach_m * reach_m) use(Square{x, y}, under);
      }
  }
}

/// Returns the squares under the body that have no triangle.
std::set<Square> empty_squares(const DrivenLine& line, const TriangleMesh& ground) {
  std::set<Square> covered, empty;
  for (const Triangle& triangle : ground.triangles) {
    Eigen::Vector3f sum = Eigen::Vector3f::Zero();
    for (const std::uint32_t v : triangle) sum += ground.vertices[v].position;
    covered.insert(square_of((sum / 3).head<2>().cast<double>()));
  }
  each_near(line, kUnderBody_m, Eigen::Vector2d::Constant(kSquare_m / 2),
            [&](const Square& square, const Under&) {
              if (!covered.contains(square)) empty.insert(square);
            });
  return empty;
}

/// Heights of the driven line's planes, shifted as the ground beside them is.
class PlanesUnderBody {
 public:
  PlanesUnderBody(const DrivenLine& line, const TriangleMesh& ground) {
    each_near(line, kUnderBody_m + kBeside_m + kSquare_m, Eigen::Vector2d::Zero(),
              [&](const Square& corner, const Under& under) {
                Under& best = planes_[corner];
                if (under.squared < best.squared) best = under;
              });
    for (const PlyPoint& vertex : ground.vertices) {
      const Eigen::Vector2d at = vertex.position.head<2>().cast<double>();
      const auto plane = planes_.find(square_of(at));
      if (plane == planes_.end()) continue;
      Sum& sum = above_[plane->first];
      sum.height_m += static_cast<double>(vertex.position.z()) - plane->second.height_at(at);
      ++sum.count;
    }
  }

  PlyPoint vertex_at(const Square& corner) const {
    constexpr std::uint8_t kGrey = 110;
    const Eigen::Vector2d at = corner_of(corner);
    const Under& plane = planes_.at(corner);
    const Eigen::Vector3d position(at.x(), at.y(), plane.height_at(at) + ground_above(corner));
    return {position.cast<float>(), plane.up.normalized().cast<float>(), {kGrey, kGrey, kGrey}};
  }

 private:
  static constexpr double kBeside_m = 2;  // reach of the ground that a square follows
  struct Sum {
    double height_m = 0;
    int count = 0;
  };

  /// Mean height of the ground above the planes around a corner; 0 where there is none.
  double ground_above(const Square& corner) const {
    constexpr int kReach = static_cast<int>(kBeside_m / kSquare_m);
    Sum sum;
    for (int x = -kReach; x < kReach; ++x)
      for (int y = -kReach; y < kReach; ++y)
        if (const auto found = above_.find({corner.first + x, corner.second + y});
            found != above_.end()) {
          sum.height_m += found->second.height_m;
          sum.count += found->second.count;
        }
    return sum.count > 0 ? sum.height_m / sum.count : 0;
  }

  std::map<Square, Under> planes_;  ///< at corners
  std::map<Square, Sum> above_;
};

}  // namespace

std::size_t fill_under_body(std::span<const Rigid3d> driven, TriangleMesh* ground) {
  const DrivenLine line(driven);
  const std::set<Square> empty = empty_squares(line, *ground);
  const PlanesUnderBody planes(line, *ground);
  std::map<Square, std::uint32_t> vertices;
  const auto vertex_at = [&](const Square& corner) {
    const auto [entry, is_new] =
        vertices.try_emplace(corner, static_cast<std::uint32_t>(ground->vertices.size()));
    if (is_new) ground->vertices.push_back(planes.vertex_at(corner));
    return entry->second;
  };
  for (const auto& [x, y] : empty) {
    const std::uint32_t a = vertex_at({x, y}), b = vertex_at({x + 1, y}),
                        c = vertex_at({x + 1, y + 1}), d = vertex_at({x, y + 1});
    ground->triangles.push_back({a, b, c});
    ground->triangles.push_back({a, c, d});
  }
  return 2 * empty.size();
}

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
