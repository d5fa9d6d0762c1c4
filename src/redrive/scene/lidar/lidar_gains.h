// SPDX-License-Identifier: Apache-2.0
// Sensors of a rig, and the beams of a sensor, scale intensities differently: surfaces that several
// of them saw tell by how much.
#pragma once

#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/scene/lidar/lidar_returns.h"
#include "redrive/scene/scene.h"

namespace redrive {

struct LidarGains {
  float gain = 1;               ///< RecordedLidar::gain
  std::vector<BeamGain> beams;  ///< RecordedLidar::beam_gains
};

/// Returns the gains of each of returns.sensors. Of a sensor: the median, over the voxels of 0.3 m
/// in which both have returns, of its mean intensity over the first sensor's, each of its own full
/// scale. 1 for the first, and where fewer than 30 voxels tell. Of a beam, where returns have
/// rings: least squares of its intensities against the mean, in voxels of 0.2 m, of those of other
/// beams over their gains, five times; their logarithms have mean 0. 1 for beams with fewer than
/// 500 such returns.
std::vector<LidarGains> estimate_gains(const Scene& scene, const LidarReturns& returns,
                                       ThreadPool& pool);

}  // namespace redrive
