// SPDX-License-Identifier: Apache-2.0
// Writes LiDAR points: LAS 1.2 (ASPRS, "LAS Specification Version 1.2", 2008), PCD 0.7 (the file
// format of the Point Cloud Library) and the scans of KITTI (recording/kitti_scan.h). Debian 12 has
// no LAS library, and its only writer of PCD is all of PCL.
#pragma once

#include <cstdint>
#include <span>
#include <string>

#include <Eigen/Core>

namespace redrive {

struct ScanPoint {
  Eigen::Vector3d position_m;
  std::int64_t t_ns = 0;
  std::uint16_t intensity = 0;
};

/// Largest coordinate of a LAS file, which stores 32-bit integers of 0.1 mm.
constexpr double kMaxLasPosition_m = 2e5;

/// Returns a LAS file of point format 1, which las.h reads: coordinates to 0.1 mm, gps_time in
/// nanoseconds, a single return for each pulse. |position_m| <= kMaxLasPosition_m and at most 2^32
/// - 1 points.
std::string make_las(std::span<const ScanPoint> points);

/// Returns a binary PCD with x, y, z as float and time in seconds as double.
std::string make_pcd(std::span<const ScanPoint> points);

/// Returns a scan of KITTI: x, y, z and a reflectance of 0 as float.
std::string make_kitti_scan(std::span<const ScanPoint> points);

/// Most lines of a file of times, one for each number of a frame, that is written.
constexpr std::int64_t kMaxKittiTimes = 1'000'000;
/// Returns a time as KITTI's timestamps.txt has it: "2011-09-26 13:10:51.175862102", UTC.
std::string kitti_timestamp(std::int64_t t_ns);

}  // namespace redrive
