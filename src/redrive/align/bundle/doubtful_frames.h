// SPDX-License-Identifier: Apache-2.0
// Frames whose image points contradict their pose. With a single wrong position of the egomotion,
// all observations of the frame become outliers, so no residual would move it.
#pragma once

#include <vector>

#include "redrive/align/rig/rig_model.h"

namespace redrive {

/// Observations of one frame, in tracks that were triangulated.
struct FrameSupport {
  int observed = 0, used = 0;  ///< used: within the noise
};

/// Indices of frames with at least 20 observations, of which less than `share` and less than half
/// as many as in the median frame are used.
std::vector<int> doubtful_frames(const std::vector<FrameSupport>& support, double share);

/// Sets initial poses and corrections of `frames` (ascending) so that both their initial and their
/// corrected poses are interpolated from the other frames': the priors no longer hold them at the
/// wrong place. Does nothing where all frames are listed.
void place_between_neighbours(const std::vector<int>& frames, RigModel* model);

/// Standard deviations of a pose that place_between_neighbours interpolated, beyond its neighbours'
/// own: RMS deviations of the poses of other frames from such interpolations. `listed`: as there;
/// `frame`: one of them. Infinite where there is no such other frame.
Vector6d interpolation_sigma(const RigModel& model, const std::vector<int>& listed, int frame);

}  // namespace redrive
