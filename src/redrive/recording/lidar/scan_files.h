// SPDX-License-Identifier: Apache-2.0
// Writes scans as PCD 0.7, the file format of the Point Cloud Library, and PLY 1.0, each with all
// that a scan has. Debian 12's only other writer of PCD is all of that library.
#pragma once

#include <span>
#include <string>

#include "redrive/recording/core/lidar_point.h"

namespace redrive {

/// Both are binary and have x, y, z and the fields of LidarRecord: intensity 0..1, ring, time in
/// seconds as double, range in metres, azimuth in radians, actor, loss.
std::string make_pcd(std::span<const LidarRecord> points);
std::string make_scan_ply(std::span<const LidarRecord> points);

}  // namespace redrive
