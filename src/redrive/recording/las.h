// SPDX-License-Identifier: Apache-2.0
// LiDAR points: LAS 1.2 (ASPRS, "LAS Specification Version 1.2", 2008), point format 1, as it is
// (.las) or compressed by LASzip
// (.laz: chunked pointwise compressor, items POINT10 and GPSTIME11, each version 2). Which one a
// file is stands in the file; its name does not matter.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string_view>
#include <vector>

#include <Eigen/Core>

namespace redrive {

/// A return. Not motion compensated: each point is where the body frame was at the point's own
/// time.
struct LidarPoint {
  Eigen::Vector3f in_body_m;  ///< |coordinate| <= 1e4, so that a float is exact to 0.5 mm, and to 8
                              ///< um within 128 m
  std::uint16_t intensity = 0;  ///< as recorded, of the sensor's own scale
  std::int64_t t_ns = 0;        ///< host clock; the file's gps_time is taken for nanoseconds
};

/// The points in the order of the file. InputError for anything else than the above, and for
/// counts, offsets and sizes that disagree with the file, damaged compressed data, a scale that is
/// not > 0, or numbers that are not finite.
std::vector<LidarPoint> parse_las(std::string_view bytes, const std::filesystem::path& file);
std::vector<LidarPoint> read_las(const std::filesystem::path& file);

}  // namespace redrive
