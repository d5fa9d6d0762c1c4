// SPDX-License-Identifier: Apache-2.0
// Velodyne scans as KITTI and KITTI-360 have them, and their times.
#pragma once

#include <atomic>
#include <filesystem>
#include <map>
#include <vector>

#include "redrive/export/drive.h"
#include "redrive/recording/formats/kitti/kitti_scan.h"

namespace redrive {

/// Writes the scans of the first LiDAR, data/ID.bin and timestamps.txt, into `folder`, for frames
/// with a pose. The formats give a point's time only by its azimuth, so each point is put where the
/// scanner saw it at that time. Drops repeated points, and for each frame all revolutions but the
/// nearest in time. Where points have rings, files have one ring after the other, as KITTI's files
/// do. `frames`: with the ids and times that are written. Returns the revolution of each scan that
/// is written, by the written id; all take the same time.
std::map<std::int64_t, kitti::ScanTime> write_velodyne_scans(
    const std::filesystem::path& folder, const Recording& drive,
    const std::vector<FramePose>& frames, std::int64_t earlier_ids, ThreadPool& pool,
    const std::atomic<bool>& stop, DriveNotes* notes);

}  // namespace redrive
