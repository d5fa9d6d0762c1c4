// SPDX-License-Identifier: Apache-2.0
// Makes LiDAR rays of a static point cloud. A cloud does not record from where its points were
// measured: each point is assigned to the nearest camera position of the drive, and points that
// others of the same position may occlude are dropped.
#pragma once

#include <span>

#include <Eigen/Core>

#include "redrive/scene/lidar_returns.h"

namespace redrive {

/// A camera position of the drive.
struct CloudOrigin {
  Eigen::Vector3d position_in_world_m;
  std::int64_t t_ns = 0;
};

/// Larger clouds are thinned evenly, in file order.
constexpr std::size_t kMaxCloudPoints = 4'000'000;

/// Returns rays from `origins` (at least one) to the points, in the order of the points. A point is
/// hidden where another point of the same origin lies in the same cell of directions (half a degree
/// on a cube's faces) at less than 0.95 of its range, or where it is closer than 0.5 m.
LidarReturns cloud_returns(std::span<const Eigen::Vector3d> in_world_m,
                           std::span<const CloudOrigin> origins, ThreadPool& pool);

}  // namespace redrive
