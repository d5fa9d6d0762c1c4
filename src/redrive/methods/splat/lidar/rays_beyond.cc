// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/lidar/rays_beyond.h"

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace redrive {
namespace {

/// Cells along the side of a face of the cube: 0.4 degrees in the mean.
constexpr int kCells = 225;
constexpr std::size_t kMostScans = 48;           ///< a longer drive's are looked at in steps
constexpr std::int64_t kGlance_ns = 12'500'000;  ///< rays that count as sent from one place
/// Farther away a cell covers so much of a road that its rays end behind and before a point of it.
constexpr float kFarthest_m = 25;
/// A ray ends at a point where it is this near to it, and passes it where it ends farther behind.
constexpr float kNear = 0.1f, kNear_m = 0.3f;
constexpr std::size_t kPointsAtOnce = 4096;

/// Returns the cell of the cube around the origin in which a direction is.
std::size_t cell_of(const Eigen::Vector3f& direction) {
  int axis = 0;
  const float most = direction.cwiseAbs().maxCoeff(&axis);
  const auto at = [&](int other) {
    return std::min(static_cast<int>((direction[other] / most + 1) / 2 * kCells), kCells - 1);
  };
  const int face = 2 * axis + (direction[axis] > 0);
  return static_cast<std::size_t>((face * kCells + at((axis + 1) % 3)) * kCells +
                                  at((axis + 2) % 3));
}

/// Ranges of rays that were sent within a short time, as seen from the place of the first.
struct Glance {
  Eigen::Vector3f origin;
  std::vector<float> range_m = std::vector<float>(std::size_t{6} * kCells * kCells);  ///< 0: none

  void take(LidarPoses* poses, std::size_t begin, std::size_t end) {
    std::ranges::fill(range_m, 0.0f);
    origin = poses->at(begin).translation().cast<float>();
    for (std::size_t i = begin; i < end; ++i) {
      const Eigen::Vector3f away = poses->in_world(i).cast<float>() - origin;
      if (const float range = away.norm(); range > 0) range_m[cell_of(away)] = range;
    }
  }
};

struct Count {
  std::uint32_t ended = 0, passed = 0;

  void add(const Glance& glance, const Eigen::Vector3f& point) {
    const Eigen::Vector3f away = point - glance.origin;
    const float distance = away.norm();
    if (!(distance > 0 && distance < kFarthest_m)) return;
    const float range = glance.range_m[cell_of(away)], near = kNear * distance + kNear_m;
    passed += range > distance + near;
    ended += range > 0 && std::abs(range - distance) <= near;
  }
};

}  // namespace

std::vector<float> shares_beyond(const Scene& scene, const LidarReturns& lidar,
                                 std::span<const Eigen::Vector3f> points, ThreadPool& pool) {
  std::vector<Count> counts(points.size());
  LidarPoses poses(scene, lidar);
  Glance glance;
  const std::size_t scans = lidar.scan_ends.size(), every = (scans + kMostScans - 1) / kMostScans;
  for (std::size_t scan = 0; scan < scans; scan += every) {
    const std::size_t last = lidar.scan_ends[scan].returns;
    for (std::size_t begin = scan == 0 ? 0 : lidar.scan_ends[scan - 1].returns, end = begin;
         begin < last; begin = end) {
      while (end < last && std::abs(lidar.t_ns[end] - lidar.t_ns[begin]) < kGlance_ns) ++end;
      glance.take(&poses, begin, end);
      pool.run_ranges(points.size(), kPointsAtOnce, [&](std::size_t from, std::size_t to) {
        for (std::size_t i = from; i < to; ++i) counts[i].add(glance, points[i]);
      });
    }
  }
  std::vector<float> shares;
  for (const Count& count : counts)
    shares.push_back(count.passed == 0 ? 0.0f
                                       : static_cast<float>(count.passed) /
                                             static_cast<float>(count.passed + count.ended));
  return shares;
}

}  // namespace redrive
