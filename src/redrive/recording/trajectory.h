// SPDX-License-Identifier: Apache-2.0
// The body's pose between the frames, for cameras and LiDAR points with times of their own.
#pragma once

#include <cstdint>
#include <vector>

#include "redrive/recording/recording.h"

namespace redrive {

/// global_from_body at time t_ns: between two frames the position is interpolated linearly and the
/// rotation along the shortest arc; before the first and after the last frame the motion of the two
/// frames there goes on. `frames`: at least one, times increasing; a single one stands still. At a
/// frame's own time its own pose, bit for bit.
Rigid3d pose_at(const std::vector<FramePose>& frames, std::int64_t t_ns);

}  // namespace redrive
