// SPDX-License-Identifier: Apache-2.0
// Poses of a drive that their neighbours contradict: single ones that lie off the path, and places
// from which on all poses are displaced, as after a new satellite fix.
#pragma once

#include <cstddef>
#include <vector>

#include "redrive/recording/core/recording.h"

namespace redrive {

/// The change from one frame to the next beyond the motion before and after it.
struct PoseJump {
  std::size_t frame = 0;  ///< index of the frame before it
  double shift_m = 0, turn_rad = 0;
};

/// A pose that lies off the motion of the frames around it.
struct StrayPose {
  std::size_t frame = 0;  ///< index
  double off_m = 0, off_rad = 0;
};

struct PoseFaults {
  std::vector<PoseJump> jumps;  ///< jumps that no stray pose explains
  std::vector<StrayPose> stray;
  bool empty() const { return jumps.empty() && stray.empty(); }
};

/// Compares the velocity between each two frames with the medians over five intervals before and
/// after it. A jump needs an acceleration that no car has (20 m/s^2; 5 rad/s^2), 0.25 m or 2
/// degrees, and eight times the noise of the drive's poses. Up to four frames between jumps or
/// between a jump and an end are stray, unless that would be more than a quarter of the drive.
/// Returns nothing for fewer than five frames. `frames`: a drive's, with increasing times.
PoseFaults find_pose_faults(const std::vector<FramePose>& frames);

/// Returns the frames with stray poses interpolated from the others.
std::vector<FramePose> without_stray_poses(std::vector<FramePose> frames, const PoseFaults& faults);

/// Describes the first few of the faults.
std::vector<Finding> describe_pose_faults(const std::vector<FramePose>& frames,
                                          const PoseFaults& faults);

}  // namespace redrive
