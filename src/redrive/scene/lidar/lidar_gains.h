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
  BlindDirections blind = {};   ///< RecordedLidar::blind
  bool operator==(const LidarGains&) const = default;
};

/// Returns the gains of each of returns.sensors.
///
/// A sensor: the median, over the voxels of 0.3 m in which both have returns, of its mean intensity
/// over the first sensor's, each of its own full scale. 1 for the first, and where fewer than 30
/// voxels tell.
///
/// A beam, where returns have rings: the least-squares ratio of its intensities to the mean of
/// other beams in voxels of 0.2 m, each divided by its own gain, in five rounds. The logarithms of
/// these gains have mean 0. A beam with fewer than 500 such returns has 1.
///
/// Blind directions: cells below -6 degrees in which 97 % of 20 rays or more were lost or returned
/// from the vehicle, over a drive that goes 10 m away at least. Nothing beside the road stays in a
/// cell for so long. Cells are steep, since far ground and the sky return nothing either.
std::vector<LidarGains> estimate_gains(const Scene& scene, const LidarReturns& returns,
                                       ThreadPool& pool);

/// Returns the geometric means of several estimates for the same sensors, for a beam over the
/// estimates that list it, and the directions in which most are blind. Empty estimates do not
/// count.
std::vector<LidarGains> mean_gains(const std::vector<std::vector<LidarGains>>& estimates);

}  // namespace redrive
