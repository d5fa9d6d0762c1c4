// SPDX-License-Identifier: Apache-2.0
// A static point cloud as the rays of a LiDAR that was never there. A cloud does not say from where
// its points were seen: each is given to the nearest place that the vehicle came by, and of a
// place's points those alone are used that none of its others may hide.
#pragma once

#include <span>

#include <Eigen/Core>

#include "redrive/scene/lidar_returns.h"

namespace redrive {

/// Where the cameras were at a time.
struct CloudOrigin {
  Eigen::Vector3d in_world_m;
  std::int64_t t_ns = 0;
};

/// At most so many points of a cloud are used, evenly picked as they lie in the file.
constexpr std::size_t kMaxCloudPoints = 4'000'000;

/// Rays from `origins` (at least one) to the points, in the order of the points. A point is hidden
/// if another one of the same origin lies in the same cell of directions (half a degree, a cube's
/// faces) at less than 0.95 of its range. Points closer than 0.5 m to their origin count as hidden.
LidarReturns cloud_returns(std::span<const Eigen::Vector3d> in_world_m,
                           std::span<const CloudOrigin> origins, ThreadPool& pool);

}  // namespace redrive
