// SPDX-License-Identifier: Apache-2.0
// Sensors of a rig scale intensities differently: surfaces that several of them saw tell by how
// much.
#pragma once

#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/scene/lidar/lidar_returns.h"
#include "redrive/scene/scene.h"

namespace redrive {

/// Returns RecordedLidar::gain of each of returns.sensors: the median, over the voxels of 0.3 m in
/// which both have returns, of its mean intensity over the first sensor's, each of its own full
/// scale. 1 for the first, and where fewer than 30 voxels tell.
std::vector<float> estimate_gains(const Scene& scene, const LidarReturns& returns,
                                  ThreadPool& pool);

}  // namespace redrive
