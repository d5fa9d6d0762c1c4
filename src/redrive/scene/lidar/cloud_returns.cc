// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/lidar/cloud_returns.h"

#include <algorithm>
#include <limits>
#include <unordered_map>

#include "redrive/base/error.h"

namespace redrive {
namespace {

constexpr std::size_t kPointsPerRange = 4096;
constexpr int kCellsPerFace = 180;  // a face of the cube around an origin spans 90 degrees
constexpr float kHiddenRange = 0.95f;

struct AssignedPoint {
  std::uint32_t origin = 0;
  bool seen = false;       ///< seen from the origin, as the cloud says
  std::uint64_t cell = 0;  ///< cell of directions from the origin
  float range_m = 0;
};

/// Returns the cell of a direction on the cube around an origin.
std::uint64_t cell_of(const Eigen::Vector3d& direction) {
  int axis;
  const double most = direction.cwiseAbs().maxCoeff(&axis);
  const auto side = [&](double x) {
    return std::min(kCellsPerFace - 1, static_cast<int>(0.5 * (x / most + 1) * kCellsPerFace));
  };
  const int face = 2 * axis + (direction[axis] < 0);
  return (static_cast<std::uint64_t>(face) * kCellsPerFace + side(direction[(axis + 1) % 3])) *
             kCellsPerFace +
         side(direction[(axis + 2) % 3]);
}

AssignedPoint assign_to_origin(const CloudPoint& in, std::span<const CloudOrigin> origins) {
  const Eigen::Vector3d& point = in.in_world_m;
  double least = std::numeric_limits<double>::infinity();
  AssignedPoint out;
  const auto assign = [&](std::size_t o) {
    if (const double square = (point - origins[o].world_from_sensor.translation()).squaredNorm();
        square < least) {
      least = square;
      out.origin = static_cast<std::uint32_t>(o);
    }
  };
  if (in.seen_from >= 0) {
    assign(static_cast<std::size_t>(in.seen_from));
    out.seen = least > 0;
  } else {
    for (std::size_t o = 0; o < origins.size(); ++o) assign(o);
  }
  out.range_m = static_cast<float>(std::sqrt(least));
  constexpr std::uint64_t kCells = 6ull * kCellsPerFace * kCellsPerFace;
  if (least > 0)
    out.cell =
        out.origin * kCells + cell_of(point - origins[out.origin].world_from_sensor.translation());
  return out;
}

}  // namespace

LidarReturns cloud_returns(std::span<const CloudPoint> cloud, std::span<const CloudOrigin> origins,
                           float least_range_m, ThreadPool& pool) {
  REDRIVE_CHECK(!origins.empty());
  const std::size_t every = (cloud.size() + kMaxCloudPoints - 1) / kMaxCloudPoints;
  std::vector<AssignedPoint> points(every > 0 ? (cloud.size() + every - 1) / every : 0);
  pool.run_ranges(points.size(), kPointsPerRange, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i)
      points[i] = assign_to_origin(cloud[i * every], origins);
  });
  std::unordered_map<std::uint64_t, float> nearest_m;
  nearest_m.reserve(points.size());
  for (const AssignedPoint& point : points) {
    const auto [at, is_new] = nearest_m.try_emplace(point.cell, point.range_m);
    if (!is_new) at->second = std::min(at->second, point.range_m);
  }

  LidarReturns returns;
  std::vector<std::size_t> used;
  for (std::size_t i = 0; i < points.size(); ++i)
    if (points[i].seen || (points[i].range_m > 0 && points[i].range_m >= least_range_m &&
                           kHiddenRange * points[i].range_m <= nearest_m.at(points[i].cell)))
      used.push_back(i);
  returns.n = used.size();
  returns.hidden = points.size() - used.size();
  returns.direction.resize(3 * returns.n);
  for (std::size_t k = 0; k < returns.n; ++k) {
    const AssignedPoint& point = points[used[k]];
    const CloudOrigin& origin = origins[point.origin];
    const Eigen::Vector3d direction = origin.world_from_sensor.inverse(Eigen::Isometry) *
                                      cloud[used[k] * every].in_world_m / point.range_m;
    for (int d = 0; d < 3; ++d)
      returns.direction[d * returns.n + k] = static_cast<float>(direction[d]);
    returns.range_m.push_back(point.range_m);
    returns.t_ns.push_back(origin.t_ns);
    returns.intensity.push_back(0);
  }
  return returns;
}

}  // namespace redrive
