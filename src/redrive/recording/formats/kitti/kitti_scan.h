// SPDX-License-Identifier: Apache-2.0
// Revolutions of the Velodyne HDL-64E of KITTI: records of four floats, little-endian: x, y, z in
// metres (x forward, y left, z up) and reflectance, 0..1.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string_view>
#include <vector>

#include "redrive/math/rigid3.h"
#include "redrive/recording/core/lidar_point.h"

namespace redrive::kitti {

constexpr std::size_t kScanRecordBytes = 16;
constexpr std::int64_t kScanColumns =
    2048;  ///< columns of a scan; the HDL-64E has about 2080 at 10 Hz

/// When the revolution begins and ends, both behind the car. Equal: its points are motion
/// compensated to that time.
struct ScanTime {
  std::int64_t start_ns = 0, end_ns = 0;
};

/// Time at which the laser points along a direction. It turns clockwise seen from above and looks
/// ahead in the middle of the revolution.
std::int64_t time_of_direction(const ScanTime& time, const Eigen::Vector3d& in_velodyne);

/// Returns the time of a point of a scan: the time of its azimuth to 1/2048 of the revolution, 0.05
/// ms, as columns of the sensor are.
std::int64_t time_of_point(const ScanTime& time, double x, double y);

/// Returns the points in the body frame in order of time (time_of_point). Points with a number that
/// is not finite, at the sensor, beyond 1000 m or with a reflectance outside 0..1 are dropped and
/// added to `left_out`. InputError: a size that is no multiple of 16 bytes, more than 4 million
/// points, distances or reflectances of more than a twentieth of the points out of range.
std::vector<LidarPoint> parse_scan(std::string_view bytes, const std::filesystem::path& file,
                                   const Rigid3d& body_from_velodyne, const ScanTime& time,
                                   std::size_t* left_out = nullptr);

}  // namespace redrive::kitti
