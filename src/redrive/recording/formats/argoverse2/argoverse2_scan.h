// SPDX-License-Identifier: Apache-2.0
// Scans of Argoverse 2: a table of the returns of two stacked Velodyne VLP-32C, which turn in the
// same direction half a revolution apart. x, y, z: metres in the vehicle's axes, where a return
// would be at the time of the file's name; intensity, 0..255; laser_number, 0..63; offset_ns, the
// return's own time after the time of the file.
#pragma once

#include <filesystem>
#include <optional>
#include <string_view>
#include <vector>

#include "redrive/recording/core/lidar_point.h"
#include "redrive/recording/core/recording.h"

namespace redrive::argoverse2 {

enum class Lidar { kUp, kDown };
constexpr int kLasersOfLidar =
    32;  ///< numbers below are the up_lidar's, the others the down_lidar's
constexpr std::int64_t kRevolution_ns = 100'000'000;

/// Returns a LiDAR's points in the body at their own times, in order of time. `poses`: the body's.
/// Rings are its lasers, 0 to 31. Adds to `left_out` returns of either that are not finite; a
/// twentieth of the returns may be further than 1000 m away, at most, or have impossible values.
/// InputError for a damaged table.
std::vector<LidarPoint> parse_scan(std::string_view feather, const std::filesystem::path& file,
                                   Lidar lidar, std::int64_t t_ns,
                                   const std::vector<FramePose>& poses,
                                   std::size_t* left_out = nullptr);

/// Whether a scan has returns of a LiDAR. InputError for a damaged table.
bool has_lasers_of(Lidar lidar, std::string_view feather, const std::filesystem::path& file);

/// When a LiDAR looks into a direction.
struct SweepTiming {
  std::int64_t first_ns = 0;        ///< the first return's time after the time of the file
  double azimuth_at_first_rad = 0;  ///< where it looks then, to the left of x
  bool turns_left = false;
  Eigen::Vector3d lidar_in_body = Eigen::Vector3d::Zero();

  /// Returns how long after the time of the file it first looks at a point.
  std::int64_t seen_after_ns(const Eigen::Vector3d& in_body) const;
};

/// Estimates it from the points of a scan; nothing without any.
std::optional<SweepTiming> sweep_timing(const std::vector<LidarPoint>& points, std::int64_t t_ns,
                                        const Rigid3d& body_from_lidar);

}  // namespace redrive::argoverse2
