// SPDX-License-Identifier: Apache-2.0
// Writes PCD 0.7, the file format of the Point Cloud Library. Debian 12's only other writer is all
// of that library.
#pragma once

#include <span>
#include <string>

#include "redrive/recording/core/lidar_point.h"

namespace redrive {

/// Returns a binary PCD with x, y, z as float and time in seconds as double.
std::string make_pcd(std::span<const LidarRecord> points);

}  // namespace redrive
