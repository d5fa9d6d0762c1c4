// SPDX-License-Identifier: Apache-2.0
// Scans of NCore: rays with their returns, each at its own time in the sensor's axes.
#pragma once

#include <cstddef>
#include <vector>

#include "redrive/recording/core/lidar_point.h"
#include "redrive/recording/core/recording.h"
#include "redrive/recording/formats/ncore/ncore_contents.h"

namespace redrive::ncore {

/// Returns the first return of each ray that has one. `left_out`: as RecordingReader::read_lidar.
/// InputError for a damaged scan.
std::vector<LidarPoint> read_scan(const Contents::Scan& scan, const Rigid3d& body_from_lidar,
                                  std::size_t* left_out);

/// Number of rays; 0 if it is not known.
std::uint64_t ray_count(const Contents::Scan& scan);
/// Returns that a ray has at most; 0 if it is not known.
std::uint64_t return_count(const Contents::Scan& scan);

}  // namespace redrive::ncore
