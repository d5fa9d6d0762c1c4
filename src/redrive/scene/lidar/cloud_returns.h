// SPDX-License-Identifier: Apache-2.0
// Makes LiDAR rays from a static point cloud. A point of a reconstruction is known to be seen from
// a position. Other points do not record from where they were measured: each is assigned to the
// nearest camera position, and dropped where points of the same position may occlude it.
#pragma once

#include <span>

#include <Eigen/Core>

#include "redrive/scene/lidar/lidar_returns.h"

namespace redrive {

/// A camera of the drive at a time.
struct CloudOrigin {
  Rigid3d world_from_sensor;  ///< metres
  std::int64_t t_ns = 0;
};

struct CloudPoint {
  Eigen::Vector3d in_world_m;
  int seen_from = -1;  ///< index of the origin that sees it; -1: unknown
};

/// Larger clouds are thinned evenly, in file order.
constexpr std::size_t kMaxCloudPoints = 4'000'000;

/// Returns rays from `origins` (at least one) to the points, in the order of the points; the caller
/// sets body_from_sensor. A point
/// without `seen_from` is hidden where another point of the same origin lies in the same cell of
/// directions (half a degree on a cube's faces) at less than 0.95 of its range, or where it is
/// closer than `least_range_m`.
LidarReturns cloud_returns(std::span<const CloudPoint> cloud, std::span<const CloudOrigin> origins,
                           float least_range_m, ThreadPool& pool);

}  // namespace redrive
