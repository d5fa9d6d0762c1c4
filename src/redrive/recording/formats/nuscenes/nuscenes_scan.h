// SPDX-License-Identifier: Apache-2.0
// Revolutions of the Velodyne HDL-32E of nuScenes, .pcd.bin: records of five floats, little-endian:
// x, y, z in metres (x right, y forward, z up), intensity 0..255 and ring 0..31. A column is what
// the 32 lasers fire at once; columns follow each other in time, and the last one has the time of
// the file.
#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/recording/core/lidar_point.h"
#include "redrive/recording/core/recording.h"

namespace redrive::nuscenes {

constexpr std::size_t kScanRecordBytes = 20;

/// Extrinsics and time of a scan, which its file does not have.
struct Revolution {
  Rigid3d body_from_lidar;
  std::int64_t end_ns = 0;
};

/// Returns the points in order of time, each in the body frame at its own time: nuScenes
/// compensates the motion to the end of the scan, which is undone by `poses` of the body. Points
/// with a number that is not finite, at the sensor, beyond 1000 m or of another ring than 0..31 are
/// dropped and added to `left_out`. InputError: a size that is no multiple of 20 bytes, columns of
/// more than 60 ms, more than a twentieth of the points too far away or of other rings. Intensities
/// are clamped to 0..255.
std::vector<LidarPoint> parse_scan(std::string_view bytes, const std::filesystem::path& file,
                                   const Revolution& revolution,
                                   const std::vector<FramePose>& poses,
                                   std::size_t* left_out = nullptr);

/// Returns a scan of points whose x axis is forward and y axis left; intensities 0..255.
std::string make_scan(std::span<const LidarRecord> points);

}  // namespace redrive::nuscenes
