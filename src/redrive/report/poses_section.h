// SPDX-License-Identifier: Apache-2.0
// The part of a run's report about its poses: their source and the corrections by training.
#pragma once

#include <string>

#include "redrive/train/poses/pose_changes.h"
#include "redrive/train/run.h"

namespace redrive {

/// Returns the section as HTML: whether the poses are the ground truth, aligned or as recorded;
/// where training refined them, a table of the cameras' corrections and plots of the frames'
/// (written to `figures` as poses_moved.png and poses_turned.png), with a warning where a
/// correction is at its bound. `run`: from open_run.
std::string poses_section(const Run& run, const std::filesystem::path& figures);

/// gnuplot scripts of the frames' corrections over time, in cm and degrees; bounds are drawn where
/// a frame comes near them.
std::string frame_translations_script(const Scene& scene, const PoseChanges& changes);
std::string frame_rotations_script(const Scene& scene, const PoseChanges& changes);

}  // namespace redrive
