// SPDX-License-Identifier: Apache-2.0
// Writes scans of KITTI (recording/formats/kitti/kitti_scan.h) with its file names and times, which
// KITTI-360 shares.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "redrive/recording/core/lidar_point.h"

namespace redrive::kitti {

/// Returns a scan: x, y, z and intensity as float.
std::string make_scan(std::span<const LidarRecord> points);

/// Maximum number of lines in a timestamps file.
constexpr std::int64_t kMaxTimes = 1'000'000;
/// Returns a time in the form of timestamps.txt: "2011-09-26 13:10:51.175862102", UTC.
std::string make_timestamp(std::int64_t t_ns);
/// Returns a timestamps file: line n belongs to frame n - 1, empty where there is no time, up to
/// the last frame. `times`: frame and nanoseconds since 1970, sorted by frame from 0 on, each frame
/// once.
std::string make_timestamps(const std::vector<std::pair<std::int64_t, std::int64_t>>& times);
/// Returns the name of a frame's file: "0000000012.bin". `extension`: with its dot.
std::string file_name(std::int64_t frame_id, const char* extension);

}  // namespace redrive::kitti
