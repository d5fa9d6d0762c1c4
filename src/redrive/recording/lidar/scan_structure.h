// SPDX-License-Identifier: Apache-2.0
// The beams of a spinning LiDAR, estimated from its scans: formats give points, not the sensor.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "redrive/math/rigid3.h"
#include "redrive/recording/core/lidar_point.h"
#include "redrive/recording/core/lidar_sensor.h"

namespace redrive {

struct ScanStructure {
  LidarSensor sensor;         ///< clockwise where its rate is unknown; azimuths of beams average 0
  double residual_rad = 0;    ///< RMS elevation about the beams, the largest twentieth left out
  double second_returns = 0;  ///< share of the rays with a second return
  std::uint16_t intensity_scale = 0;
};

/// Whether some of the points have a ring. Others are another sensor's, then: they belong to no
/// beam.
bool has_rings(std::span<const LidarPoint> points);

/// Estimates the structure. Beams are the rings of the points or, where none has one, clusters of
/// elevations that 0.02 degrees separate. Rate, heading and steps follow from azimuths over
/// time; without a rate, azimuths of beams are 0. Nothing, and the reason in `why`, where there are
/// fewer than 1000 returns, or no beam has 20.
std::optional<ScanStructure> estimate_structure(std::span<const std::vector<LidarPoint>> scans,
                                                const Rigid3d& body_from_lidar, std::string* why);

/// Returns for each point the index of its beam: the one whose elevation is nearest to the median
/// of its ring, since formats may number the rings of each scan anew, or, where no point has a
/// ring, to its own. kNoRing: a point without a ring beside others, or at the sensor.
std::vector<std::uint8_t> beams_of(std::span<const LidarPoint> points,
                                   const Rigid3d& body_from_lidar, const LidarSensor& sensor);

/// Returns why the returns are too far off the beams to know where these were fired; nothing where
/// they are not.
std::optional<std::string> misfit(const ScanStructure& structure);

}  // namespace redrive
