// SPDX-License-Identifier: Apache-2.0
// Velodyne scans as KITTI-360 has them, and their times.
#pragma once

#include <atomic>
#include <vector>

#include "redrive/export/drive.h"
#include "redrive/recording/formats/kitti360/kitti360.h"

namespace redrive {

/// Writes the scans of frames with a pose, their times and calib_cam_to_velo.txt. The format gives
/// a point's time only by its azimuth, so each point is put where the scanner saw it at that time.
/// Drops repeated points, and for each frame all revolutions but the nearest in time. `frames`:
/// with the ids and times that are written.
void write_kitti360_scans(const kitti360::Layout& layout, const Recording& drive,
                          const std::vector<FramePose>& frames, std::int64_t earlier_ids,
                          const Rigid3d& body_from_first_camera, ThreadPool& pool,
                          const std::atomic<bool>& stop, DriveNotes* notes);

}  // namespace redrive
