// SPDX-License-Identifier: Apache-2.0
// The beams of a spinning LiDAR, estimated from its scans: formats give points, not the sensor.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "redrive/math/rigid3.h"
#include "redrive/recording/core/lidar_point.h"

namespace redrive {

/// A beam turns about the sensor's z axis at a fixed elevation.
struct LidarBeam {
  double elevation_rad = 0;  ///< upwards from the plane of rotation
  double azimuth_rad = 0;    ///< to the left of the sensor's heading; their mean is 0
  std::size_t returns = 0;
};

struct ScanStructure {
  std::vector<LidarBeam> beams;   ///< from the lowest to the highest
  int azimuth_steps = 0;          ///< firings of a beam in a revolution; 0: unknown
  std::optional<double> rate_hz;  ///< revolutions a second; nothing where a scan has one time
  bool clockwise = true;          ///< seen from above; true where rate_hz is unknown
  double residual_rad = 0;        ///< RMS elevation about the beams, the largest twentieth left out
  double min_range_m = 0, max_range_m = 0;  ///< ranges of the returns
  double second_returns = 0;                ///< share of the rays with a second return
};

/// Estimates the structure. Beams are the rings of the points or, where these have none, clusters
/// of elevations that 0.02 degrees separate. Rate, heading and steps follow from azimuths over
/// time; without a rate, azimuths of beams are 0. Nothing, and the reason in `why`, where there are
/// fewer than 1000 returns, or no beam has 20.
std::optional<ScanStructure> estimate_structure(std::span<const std::vector<LidarPoint>> scans,
                                                const Rigid3d& body_from_lidar, std::string* why);

}  // namespace redrive
