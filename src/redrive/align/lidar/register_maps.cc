// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/lidar/register_maps.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <set>
#include <unordered_map>

#include <Eigen/Dense>

#include "redrive/math/angles.h"
#include "redrive/math/plane_fit.h"
#include "redrive/math/so3.h"
#include "redrive/math/voxel_grid.h"

namespace redrive {
namespace {

using Eigen::Vector3d;
using Matrix6 = Eigen::Matrix<double, 6, 6>;

constexpr double kPixel_m = 0.5, kUpright_m = 0.7;  // pixel and least height of the view from above
constexpr double kTurn_rad = 1 * kRadiansPerDegree;
// cells of planes; cells of the points moved onto them
constexpr double kCell_m = 1, kThinned_m = 0.5;
constexpr int kMinCellPoints = 8;
constexpr double kMaxPlane_m = 0.1;  // deviation of points from their plane
// distance of a point that fits; noise of a cell
constexpr double kOnPlane_m = 0.15, kNoise_m = 0.05;
constexpr double kLeastSigma_m = 0.02, kLeastSigma_rad = 0.03 * kRadiansPerDegree;
// where no surface constrains it
constexpr double kUnknown_m = 3, kUnknown_rad = 3 * kRadiansPerDegree;
constexpr double kSeen_m = 25, kAboveGround_m = 0.4;
constexpr double kMinOverlap = 0.5, kMinUpright = 0.5;
constexpr std::size_t kMinMatches = 300, kMinUprightPoints = 100;

/// The lowest and the highest point of a column.
struct Column {
  double low = 1e9, high = -1e9;
  bool upright() const { return high - low > kUpright_m; }
};
using Columns = std::unordered_map<std::uint64_t, Column>;

Voxel column_of(const Vector3d& p) {
  Voxel cell = voxel_of(p, kPixel_m);
  cell.z() = 0;
  return cell;
}

Columns columns_of(const PointMap& points) {
  Columns columns;
  for (const Vector3d& p : points) {
    Column& column = columns[voxel_key(column_of(p))];
    column.low = std::min(column.low, p.z());
    column.high = std::max(column.high, p.z());
  }
  return columns;
}

/// Centres of the upright columns, on the ground.
std::vector<Vector3d> upright_places(const PointMap& points, const Columns& columns) {
  std::set<std::uint64_t> places;
  for (const Vector3d& p : points)
    if (const std::uint64_t key = voxel_key(column_of(p)); columns.at(key).upright())
      places.insert(key);
  std::vector<Vector3d> result;
  for (const std::uint64_t key : places)
    result.push_back(kPixel_m * (voxel_of_key(key).cast<double>() + Vector3d(0.5, 0.5, 0)));
  return result;
}

/// A map seen from above: 2 where a column is upright, 1 beside it.
class View {
 public:
  View(const std::vector<Vector3d>& places, double reach_m)
      : half_(static_cast<int>(std::ceil(reach_m / kPixel_m)) + 2),
        side_(2 * half_ + 1),
        pixels_(static_cast<std::size_t>(side_) * static_cast<std::size_t>(side_)) {
    for (const int value : {1, 2})
      for (const Vector3d& place : places) {
        const Voxel cell = column_of(place);
        const int beside = value == 1;
        for (int dx = -beside; dx <= beside; ++dx)
          for (int dy = -beside; dy <= beside; ++dy)
            if (inside(cell.x() + dx, cell.y() + dy))
              pixels_[index(cell.x() + dx, cell.y() + dy)] = static_cast<std::uint8_t>(value);
      }
  }
  int at(std::int64_t x, std::int64_t y) const { return inside(x, y) ? pixels_[index(x, y)] : 0; }

 private:
  bool inside(std::int64_t x, std::int64_t y) const {
    return std::abs(x) <= half_ && std::abs(y) <= half_;
  }
  std::size_t index(std::int64_t x, std::int64_t y) const {
    return static_cast<std::size_t>(y + half_) * static_cast<std::size_t>(side_) +
           static_cast<std::size_t>(x + half_);
  }
  int half_, side_;
  std::vector<std::uint8_t> pixels_;
};

/// Returns the guess, turned and shifted to where upright columns overlap best. Among equally good
/// places the nearest counts.
Rigid3d correlated(const PointMap& target, const PointMap& source, const Rigid3d& guess,
                   double search_m, double search_rad) {
  PointMap moved;
  for (const Vector3d& p : source) moved.push_back(guess * p);
  const Columns of_target = columns_of(target), of_source = columns_of(moved);
  const View view(upright_places(target, of_target), kMapReach_m + search_m);
  const std::vector<Vector3d> places = upright_places(moved, of_source);
  const Vector3d middle = guess.translation();
  const int most = static_cast<int>(std::ceil(search_m / kPixel_m)),
            turns = static_cast<int>(std::ceil(search_rad / kTurn_rad));
  double best = -1;
  int best_turn = 0, best_x = 0, best_y = 0;
  for (int turn = -turns; turn <= turns; ++turn) {
    const Eigen::Matrix3d rotation = so3_exp({0, 0, turn * kTurn_rad});
    std::vector<Voxel> cells;
    for (const Vector3d& place : places)
      cells.push_back(column_of(middle + rotation * (place - middle)));
    for (int x = -most; x <= most; ++x)
      for (int y = -most; y <= most; ++y) {
        int sum = 0;
        for (const Voxel& cell : cells) sum += view.at(cell.x() + x, cell.y() + y);
        const double far = std::hypot(x, y) / std::max(most, 1),
                     turned = double(turn) / std::max(turns, 1),
                     score = sum * (1 - 0.1 * far * far - 0.1 * turned * turned);
        if (score > best) best = score, best_turn = turn, best_x = x, best_y = y;
      }
  }
  Rigid3d result = Rigid3d::Identity();
  result.linear() = so3_exp({0, 0, best_turn * kTurn_rad});
  result.translation() = middle - result.linear() * middle + kPixel_m * Vector3d(best_x, best_y, 0);
  // The height is the median over columns without anything upright.
  std::vector<double> steps;
  for (const Vector3d& p : moved) {
    if (of_source.at(voxel_key(column_of(p))).upright()) continue;
    const auto found = of_target.find(voxel_key(column_of(result * p)));
    if (found != of_target.end() && !found->second.upright())
      steps.push_back(found->second.low - p.z());
  }
  if (!steps.empty()) {
    const auto half = steps.begin() + std::ssize(steps) / 2;
    std::nth_element(steps.begin(), half, steps.end());
    result.translation().z() += *half;
  }
  return result * guess;
}

struct Plane {
  Vector3d mean, normal;
  int used = 0;  ///< points that lie on it, in this iteration
};

/// A cell's points: with a plane, where they lie on one.
struct Cell {
  PlaneSums points;
  bool planar = false;
  Plane plane;
};
using Cells = std::unordered_map<std::uint64_t, Cell>;

Cells cells_of(const PointMap& points) {
  Cells cells;
  for (const Vector3d& p : points) cells[voxel_key(voxel_of(p, kCell_m))].points.add(p);
  for (auto& [key, cell] : cells) {
    const PlaneFit fit = cell.points.fit();
    const Vector3d sd = fit.extent();
    cell.planar = cell.points.n() >= kMinCellPoints && sd[0] < kMaxPlane_m && sd[1] > 0.1 &&
                  sd[1] > 2 * sd[0];
    cell.plane.mean = fit.mean;
    cell.plane.normal = fit.normal();
  }
  return cells;
}

/// The mean of the points of each cell.
PointMap thinned(const PointMap& points) {
  std::vector<std::uint64_t> keys;
  for (const Vector3d& p : points) keys.push_back(voxel_key(voxel_of(p, kThinned_m)));
  const VoxelGroups voxels(keys);
  PointMap result;
  for (std::size_t v = 0; v < voxels.size(); ++v) {
    Vector3d sum = Vector3d::Zero();
    for (const std::uint32_t i : voxels[v]) sum += points[i];
    result.push_back(sum / static_cast<double>(voxels[v].size()));
  }
  return result;
}

/// Returns the planar cell around a point, or the neighbouring one to whose plane it is nearest;
/// null if there is none. *near: whether there are any points.
Cell* plane_at(Cells* cells, const Vector3d& p, bool* near) {
  const Voxel at = voxel_of(p, kCell_m);
  Cell* best = nullptr;
  double least_m = kCell_m;
  for (const Voxel& to : {Voxel(0, 0, 0), Voxel(1, 0, 0), Voxel(-1, 0, 0), Voxel(0, 1, 0),
                          Voxel(0, -1, 0), Voxel(0, 0, 1), Voxel(0, 0, -1)}) {
    const auto found = cells->find(voxel_key(at + to));
    if (found == cells->end()) continue;
    *near = true;
    Cell& cell = found->second;
    if (!cell.planar) continue;
    if (to.isZero()) return &cell;
    const double distance_m = std::abs(cell.plane.normal.dot(p - cell.plane.mean));
    if ((p - cell.plane.mean).norm() < kCell_m && distance_m < least_m)
      best = &cell, least_m = distance_m;
  }
  return best;
}

/// A registration's normal equations, by the source's pose [exp(phi), rho] in its own axes.
struct NormalEquations {
  Matrix6 normal = Matrix6::Zero();
  Eigen::Matrix<double, 6, 1> right = Eigen::Matrix<double, 6, 1>::Zero();
  std::size_t near = 0, on = 0;
  double squares = 0;
};

/// Each cell of the target counts as one observation of kNoise_m, however many points lie on it.
NormalEquations sums_of(Cells* cells, const PointMap& source, const Rigid3d& pose, double gate_m) {
  struct Match {
    const Vector3d* point;
    Plane* plane;
    double residual_m;
  };
  NormalEquations sums;
  std::vector<Match> matches;
  for (const Vector3d& q : source) {
    const Vector3d p = pose * q;
    bool near = false;
    Cell* const cell = plane_at(cells, p, &near);
    sums.near += near;
    if (!cell) continue;
    const double residual_m = cell->plane.normal.dot(p - cell->plane.mean);
    if (std::abs(residual_m) < kOnPlane_m) {
      ++sums.on;
      sums.squares += residual_m * residual_m;
    }
    if (std::abs(residual_m) >= gate_m) continue;
    matches.push_back({&q, &cell->plane, residual_m});
    ++cell->plane.used;
  }
  for (const Match& match : matches) {
    const double robust = match.residual_m / (2 * kNoise_m),
                 weight = 1 / (kNoise_m * kNoise_m * match.plane->used * (1 + robust * robust));
    const Vector3d normal = pose.linear().transpose() * match.plane->normal;
    Eigen::Matrix<double, 6, 1> derivative;
    derivative << normal, match.point->cross(normal);
    sums.normal += weight * derivative * derivative.transpose();
    sums.right -= weight * match.residual_m * derivative;
  }
  for (const Match& match : matches) match.plane->used = 0;
  return sums;
}

/// MapRegistration::upright; the ground is the lowest point of the columns around. *count: of
/// points that are above it.
double upright_on(Cells* cells, const PointMap& source, const PointMap& points, const Rigid3d& pose,
                  std::size_t* count) {
  const Columns columns = columns_of(source);
  std::size_t on = 0;
  for (const Vector3d& q : points) {
    const Vector3d p = pose * q;
    if (std::max(p.head<2>().norm(), q.head<2>().norm()) > kSeen_m) continue;
    double ground_m = q.z();
    for (int x = -2; x <= 2; ++x)
      for (int y = -2; y <= 2; ++y)
        if (const auto found = columns.find(voxel_key(column_of(q) + Voxel(x, y, 0)));
            found != columns.end())
          ground_m = std::min(ground_m, found->second.low);
    if (q.z() < ground_m + kAboveGround_m) continue;
    ++*count;
    bool near = false;
    const Cell* const cell = plane_at(cells, p, &near);
    const auto own = cells->find(voxel_key(voxel_of(p, kCell_m)));
    on += cell ? std::abs(cell->plane.normal.dot(p - cell->plane.mean)) < kOnPlane_m
               : own != cells->end() && own->second.points.n() >= kMinCellPoints;
  }
  return *count > 0 ? static_cast<double>(on) / static_cast<double>(*count) : 0;
}

}  // namespace

MapRegistration register_maps(const PointMap& target, const PointMap& source, const Rigid3d& guess,
                              double search_m, double search_rad) {
  MapRegistration found;
  found.target_from_source = guess;
  if (target.empty() || source.empty()) {
    found.doubt = "there are no LiDAR points";
    return found;
  }
  Rigid3d pose = correlated(target, source, guess, search_m, search_rad);
  Cells cells = cells_of(target);
  const PointMap points = thinned(source);
  Eigen::Matrix<double, 6, 1> unknown;
  unknown << Vector3d::Constant(1 / (kUnknown_m * kUnknown_m)),
      Vector3d::Constant(1 / (kUnknown_rad * kUnknown_rad));
  NormalEquations sums;
  for (int i = 0; i < 30; ++i) {
    sums = sums_of(&cells, points, pose, i < 6 ? 1 : i < 12 ? 0.5 : 0.25);
    sums.normal += unknown.asDiagonal();
    const Eigen::Matrix<double, 6, 1> by = sums.normal.ldlt().solve(sums.right);
    Rigid3d change = Rigid3d::Identity();
    change.linear() = so3_exp(by.tail<3>());
    change.translation() = by.head<3>();
    pose = pose * change;
    if (i > 12 && by.head<3>().norm() < 1e-4 && by.tail<3>().norm() < 1e-5) break;
  }
  found.target_from_source = pose;
  found.covariance = sums.normal.inverse();
  found.covariance.diagonal().head<3>().array() += kLeastSigma_m * kLeastSigma_m;
  found.covariance.diagonal().tail<3>().array() += kLeastSigma_rad * kLeastSigma_rad;
  const double on = static_cast<double>(sums.on);
  found.overlap = static_cast<double>(sums.near) / static_cast<double>(points.size());
  found.residual_m = on > 0 ? std::sqrt(sums.squares / on) : 0;
  std::size_t upright = 0;
  found.upright = upright_on(&cells, source, points, pose, &upright);
  if (found.overlap < kMinOverlap || sums.on < kMinMatches)
    found.doubt = "the passes overlap too little";
  else if (upright < kMinUprightPoints)
    found.doubt = "nothing stands beside the road";
  else if (found.upright < kMinUpright)
    found.doubt = "their surfaces do not fit";
  return found;
}

}  // namespace redrive
