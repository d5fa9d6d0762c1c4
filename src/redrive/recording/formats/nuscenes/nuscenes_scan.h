// SPDX-License-Identifier: Apache-2.0
// Revolutions of LIDAR_TOP, .pcd.bin: records of five floats, little-endian: x, y, z in metres (x
// right, y forward, z up), intensity 0..255 and ring. A column is what all lasers fire at once;
// columns follow each other in time, and the last one has the time of the file. nuScenes has a
// Velodyne HDL-32E, whose 32 lasers fire every 46.08 us. Other sensors' columns are spread evenly
// over the revolution.
#pragma once

#include <cstdint>
#include <filesystem>
#include <numbers>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/recording/core/lidar_point.h"
#include "redrive/recording/core/recording.h"

namespace redrive::nuscenes {

constexpr std::size_t kScanRecordBytes = 20;

/// How a sensor turns, by azimuths atan2(y, x) in its axes. The HDL-32E turns clockwise and starts
/// at -x, on the left of the car.
struct Spin {
  std::int64_t duration_ns = 50'000'000;
  double first_rad = std::numbers::pi;
  double turn_rad = -2 * std::numbers::pi;  ///< within the duration; 0: not known

  /// Returns the time at which a scan that ends at `end_ns` sees a direction; end_ns if not known.
  std::int64_t time_of(const Eigen::Vector3d& in_lidar, std::int64_t end_ns) const;
};

/// Returns how the sensor of a scan turns, by the order of its records. `duration_ns`: length of a
/// revolution; 0: not known, 0.1 s for other sensors than the HDL-32E. InputError as parse_scan.
Spin spin_of(std::string_view bytes, const std::filesystem::path& file, std::int64_t duration_ns);

/// Extrinsics and time of a scan, which its file does not have.
struct Revolution {
  Rigid3d body_from_lidar;
  std::int64_t end_ns = 0;
  Spin spin = {};  ///< counts for other sensors than the HDL-32E
};

/// Returns the points in order of time, each in the body frame at its own time, which is the scan's
/// for a sensor whose spin is not known: nuScenes
/// compensates the motion to the end of the scan, which is undone by `poses` of the body. Points
/// with a number that is not finite, at the sensor, beyond 1000 m or of another ring than 0..254
/// are dropped and added to `left_out`. InputError: a size that is no multiple of 20 bytes, more
/// than a twentieth of the points too far away or of other rings. Intensities are clamped to
/// 0..255, rings that are all 0 count as not known.
std::vector<LidarPoint> parse_scan(std::string_view bytes, const std::filesystem::path& file,
                                   const Revolution& revolution,
                                   const std::vector<FramePose>& poses,
                                   std::size_t* left_out = nullptr);

/// Returns a scan of points whose x axis is forward and y axis left; intensities 0..255, rings that
/// are not known 0.
std::string make_scan(std::span<const LidarRecord> points);

}  // namespace redrive::nuscenes
