// SPDX-License-Identifier: Apache-2.0
// Where a run's poses come from and what training made of them, as a part of its report.
#pragma once

#include <string>

#include "redrive/train/pose_changes.h"
#include "redrive/train/run.h"

namespace redrive {

/// "Poses": of --truth-poses, --align or --poses, or as recorded; where training refined them, how
/// each camera was corrected and, drawn into `figures` as poses_moved.png and poses_turned.png,
/// each frame, with a warning where a correction is at its bound. `run`: open_run.
std::string poses_section(const Run& run, const std::filesystem::path& figures);

/// The plots' gnuplot scripts: cm and degrees over time, bounds where a frame comes near.
std::string frame_translations_script(const Scene& scene, const PoseChanges& changes);
std::string frame_rotations_script(const Scene& scene, const PoseChanges& changes);

}  // namespace redrive
