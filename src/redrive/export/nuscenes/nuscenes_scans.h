// SPDX-License-Identifier: Apache-2.0
// The scans of a drive as files of LIDAR_TOP, and which returns lie on its objects.
#pragma once

#include <atomic>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <string>
#include <vector>

#include "redrive/export/drive.h"

namespace redrive::nuscenes {

constexpr std::int64_t kNoPoint_ns = std::numeric_limits<std::int64_t>::min();

struct Scan {
  FrameFile file;
  const FrameFile* before = nullptr;  ///< scan whose points may be repeated
  std::int64_t end_ns = kNoPoint_ns;  ///< time of its last point
  std::uint16_t most_intensity = 0;
};

/// Returns the scans of the first LiDAR that have points within the poses, in order of time;
/// `files`: Recording::scans_of. Names others in `notes`.
std::vector<Scan> list_scans(const Recording& drive, const std::vector<FrameFile>& files,
                             ThreadPool& pool, const std::atomic<bool>& stop, DriveNotes* notes);

/// Returns the axes of LIDAR_TOP, x right, y forward, z up.
Rigid3d body_from_lidar_top(const Recording& drive);

/// The returns of a scan on one object.
struct ObjectReturns {
  std::size_t n = 0;
  std::int64_t t_ns = 0;  ///< their mean time; without any the scan passed the box then
};

/// Writes the file of a scan, compensated for the motion until `end_ns`. Returns what lies in the
/// boxes, which move as they say.
std::vector<ObjectReturns> write_scan(const std::filesystem::path& file, const Recording& drive,
                                      const Scan& scan, std::int64_t end_ns, float full_scale,
                                      const std::vector<Box>& boxes);

}  // namespace redrive::nuscenes
