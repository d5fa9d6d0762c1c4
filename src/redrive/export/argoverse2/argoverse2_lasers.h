// SPDX-License-Identifier: Apache-2.0
// A drive's LiDARs in place of Argoverse 2's two, up_lidar and down_lidar of 32 lasers each.
#pragma once

#include <optional>
#include <vector>

#include "redrive/export/drive.h"
#include "redrive/recording/core/lidar_point.h"
#include "redrive/recording/core/lidar_sensor.h"

namespace redrive::argoverse2 {

struct LasersOfLidar {
  std::size_t lidar = 0;              ///< index in Recording::lidars
  int first = 0, count = 0;           ///< laser numbers
  std::optional<LidarSensor> sensor;  ///< nothing: beams unknown, rings are numbers

  /// Returns the laser number of each point.
  std::vector<std::uint8_t> numbers(const Recording& drive,
                                    const std::vector<LidarPoint>& points) const;
};

/// Returns the LiDARs that fit. One of 33 beams or more has all 64 numbers, which beams share where
/// it has more; one of at most 32, or of unknown ones, has 32. Names the others in `notes`.
std::vector<LasersOfLidar> assign_lasers(const Recording& drive, DriveNotes* notes);

}  // namespace redrive::argoverse2
