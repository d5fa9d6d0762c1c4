// SPDX-License-Identifier: Apache-2.0
// The LiDAR of a recording as a sensor to simulate.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "redrive/base/parallel.h"
#include "redrive/recording/core/lidar_sensor.h"
#include "redrive/recording/lidar/scan_structure.h"
#include "redrive/scene/scene.h"

namespace redrive {

/// Returns the firings of a LiDAR's recorded revolution of a frame: firings with a recorded return,
/// without returns on the vehicle itself; of several revolutions the one whose middle is nearest to
/// the frame. Nothing where the recording has no revolution or no pose of the frame, or none of the
/// points has a pose. Axes are the sensor's. `lidar`: index in Recording::lidars. InputError for a
/// damaged file.
std::optional<LidarFirings> recorded_firings(const Recording& recording, const Scene& scene,
                                             std::int64_t frame_id, ThreadPool& pool,
                                             std::size_t lidar = 0);

/// Estimates the beams of a LiDAR of the recording from its middle scan and the one after it, which
/// may be damaged. Nothing, and the reason in `why`, where the scans do not tell.
std::optional<ScanStructure> recorded_structure(const Recording& recording, std::string* why,
                                                std::size_t lidar = 0);

}  // namespace redrive
