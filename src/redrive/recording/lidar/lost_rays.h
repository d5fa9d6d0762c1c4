// SPDX-License-Identifier: Apache-2.0
// The rays of a revolution that were fired and had no return: recordings leave them out.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "redrive/recording/lidar/scan_structure.h"

namespace redrive {

/// Lost rays by time.
struct LostRays {
  std::vector<Eigen::Vector3f> direction;  ///< unit, in the sensor's axes
  std::vector<std::int64_t> t_ns;          ///< host clock
  std::vector<std::uint8_t> beam;          ///< index in LidarSensor::beams
  std::size_t returned = 0;                ///< rays of the revolution that did have a return

  std::size_t size() const { return t_ns.size(); }
};

/// Finds the lost rays of a revolution: each beam fires one step after the other from the first
/// column with returns to the last, so that a gap of n steps between two of its returns has n - 1
/// lost rays. No lost ray is nearer than half a step to a return of its beam. Nothing, and the
/// reason in `why`, where steps are unknown or the structure does not fit the points.
LostRays lost_rays(std::span<const LidarPoint> points, const Rigid3d& body_from_lidar,
                   const ScanStructure& structure, std::string* why = nullptr);

}  // namespace redrive
