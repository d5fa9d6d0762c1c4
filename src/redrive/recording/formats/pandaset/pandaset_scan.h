// SPDX-License-Identifier: Apache-2.0
// Scans of PandaSet: a table of points in the world, where they were at their own times, of both
// LiDARs: x, y, z in metres, i, 0..255, t in seconds, and d, the sensor.
#pragma once

#include <filesystem>
#include <string_view>
#include <vector>

#include "redrive/recording/core/lidar_point.h"
#include "redrive/recording/core/recording.h"

namespace redrive::pandaset {

constexpr std::uint64_t kMaxPickleBytes = std::uint64_t{1} << 28;  ///< thirty usual scans
constexpr double kMaxTime_s = 9e9, kMaxCoordinate_m = 1e7;
constexpr std::size_t kPointBytes = 48;  ///< x, y, z, i, t and d of a point

/// Values of `d`.
enum class Lidar { kPandar64 = 0, kPandarGt = 1 };

/// Returns nanoseconds of seconds since 1970, of which a double has a quarter of a microsecond.
std::int64_t nanoseconds(double seconds);

/// Returns the bytes of a gzip file. InputError if it is damaged or too large.
std::string unpack(std::string_view bytes, const std::filesystem::path& file);

/// Returns the points of one LiDAR in body axes, in order of time, at the body's poses `frames`, so
/// that they lie in the world where the file has them. Rings of the Pandar64 are its beams nearest
/// in elevation. Adds to `left_out` what is not finite; a twentieth of the points may be further
/// than 1000 m away, at most, or have impossible intensities or times. InputError for a damaged
/// table.
std::vector<LidarPoint> parse_scan(std::string_view pickle, const std::filesystem::path& file,
                                   Lidar lidar, const std::vector<FramePose>& frames,
                                   const Rigid3d& body_from_lidar, std::size_t* left_out = nullptr);

}  // namespace redrive::pandaset
