// SPDX-License-Identifier: Apache-2.0
// Normals of a point cloud.
#pragma once

#include <span>

#include "redrive/base/parallel.h"
#include "redrive/recording/lidar/ply.h"

namespace redrive {

/// Sets the unit normal of each point: the normal of the plane through its 12 nearest points,
/// turned to seen_from[i]; 0 where these lie on a line or there are fewer.
void estimate_normals(std::span<const Eigen::Vector3f> seen_from, ThreadPool& pool,
                      std::span<PlyPoint> points);

}  // namespace redrive
