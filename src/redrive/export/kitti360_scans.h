// SPDX-License-Identifier: Apache-2.0
// Times and Velodyne scans as KITTI-360 has them.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "redrive/export/drive.h"
#include "redrive/recording/kitti360.h"

namespace redrive {

/// timestamps.txt: a line of date and time for each frame up to the last, empty where there is no
/// time. `times`: frame and nanoseconds since 1970, by frame, each frame once.
std::string kitti360_timestamps(const std::vector<std::pair<std::int64_t, std::int64_t>>& times);

/// Writes the scans of frames with a pose, their times and calib_cam_to_velo.txt. The format knows
/// a point's time by its azimuth alone, so each point is put where the scanner saw it at that time.
/// Repeated points are left out, and all revolutions of a frame but the nearest in time. `frames`:
/// with the ids and times that are written.
void write_kitti360_scans(const kitti360::Layout& layout, const Recording& drive,
                          const std::vector<FramePose>& frames, std::int64_t earlier_ids,
                          const Rigid3d& body_from_first_camera, ThreadPool& pool,
                          const std::atomic<bool>& stop, DriveNotes* notes);

}  // namespace redrive
