// SPDX-License-Identifier: Apache-2.0
// LiDAR points from LAS 1.0 to 1.4 (ASPRS, "LAS Specification 1.4 - R15", 2019), point formats 0 to
// 10 (.las), or formats 0 to 3 compressed by LASzip (.laz: chunked pointwise compressor, items
// POINT10, GPSTIME11, RGB12 and BYTE, each version 2). The header distinguishes them, not the
// file's name.
#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/recording/core/lidar_point.h"

namespace redrive {

/// Returns the points in the order of the file. gps_time is taken as nanoseconds; points of a
/// format without it have `frame_time_ns`. Points with a coordinate above 1e4 m or without a
/// possible time are dropped and added to `left_out`. InputError for more than a twentieth of them,
/// other versions and formats, counts, offsets and sizes that contradict the file, damaged
/// compressed data, scales <= 0, and header fields that are not finite.
std::vector<LidarPoint> parse_las(std::string_view bytes, const std::filesystem::path& file,
                                  std::int64_t frame_time_ns = 0, std::size_t* left_out = nullptr);
std::vector<LidarPoint> read_las(const std::filesystem::path& file, std::int64_t frame_time_ns = 0,
                                 std::size_t* left_out = nullptr);

/// Returns the largest coordinate of a LAS file, which stores 32-bit integers of step_m.
constexpr double max_las_position_m(double step_m) { return 2e9 * step_m; }

/// What a LAS file has of a LidarRecord.
enum class LasFields {
  kReturn,  ///< position, intensity, time
  kAll,     ///< also ring, azimuth, range, actor and loss, as extra bytes
};

/// Returns a plain LAS 1.2 file of point format 1: coordinates to step_m, intensity in all of its
/// 16 bits, gps_time in nanoseconds, a single return for each pulse. |position_m| <=
/// max_las_position_m and at most 2^32 - 1 points. Debian 12 has no LAS library.
std::string make_las(std::span<const LidarRecord> points, double step_m = 1e-4,
                     LasFields fields = LasFields::kReturn);

/// Returns the number of points in the header, or 0 if that is damaged or the file is cut.
std::uint64_t las_point_count(const std::filesystem::path& file);

}  // namespace redrive
