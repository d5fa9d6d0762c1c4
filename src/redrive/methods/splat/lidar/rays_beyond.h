// SPDX-License-Identifier: Apache-2.0
// Shares of a LiDAR's rays that pass a point. Wire fences and foliage have returns, while most rays
// go on beyond them; Gaussians there that begin opaque would take long to become transparent.
#pragma once

#include <span>
#include <vector>

#include <Eigen/Core>

#include "redrive/base/parallel.h"
#include "redrive/scene/lidar/lidar_returns.h"

namespace redrive {

/// Returns for each point, in the world, the share of the rays towards it that came back from
/// farther away: 0 to 1, and 0 where no ray looks. `lidar`: scans, not a point cloud.
std::vector<float> shares_beyond(const Scene& scene, const LidarReturns& lidar,
                                 std::span<const Eigen::Vector3f> points, ThreadPool& pool);

}  // namespace redrive
