// SPDX-License-Identifier: Apache-2.0
// Scans of novel views that a made recording has as ground truth: the folder lidar beside
// novel/<name>/poses.json, with files frame_<id>.las or .laz as recorded scans are.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "redrive/edit/view_requests.h"
#include "redrive/eval/lidar_score.h"
#include "redrive/recording/core/register_trajectories.h"

namespace redrive {

/// The scans of one novel set.
struct NovelScans {
  std::string name;  ///< name of the set
  ViewRequests poses;
  std::vector<FrameFile> files;  ///< scans of frames that the run has
};

/// Returns the novel sets of the run's recording that have scans; findings list files of other
/// names. InputError: poses.json is malformed, two files are of one frame, or a scan has no pose.
std::vector<NovelScans> novel_scans(const Run& run, std::vector<Finding>* findings);

/// Scores the scans of a set and counts them. A scan's body is where a view of its frame has it, by
/// the ground truth in the run's alignment, else by the shift, and moves with the run's own before
/// and after the frame. InputError for a damaged file.
std::optional<LidarScore> score_novel_scans(const Run& run, kernels::Backend& backend,
                                            const TrajectoryRegistration& alignment,
                                            const NovelScans& scans, const MovingObjects& left_out,
                                            Progress* progress = nullptr);

}  // namespace redrive
