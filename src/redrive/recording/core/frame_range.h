// SPDX-License-Identifier: Apache-2.0
// --frames of commands: a part of a recording by its frames' ids.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "redrive/recording/core/recording.h"

namespace redrive {

struct FrameRange {
  std::int64_t first = -1, last = -1;  ///< ids, inclusive; -1: open
  int step = 1;                        ///< every n-th existing frame, >= 1
};

/// "FIRST:LAST[:STEP]", either end may be empty; an empty text is everything. UsageError.
FrameRange parse_frame_range(const std::string& text);

/// Returns the frames of the range. UsageError if there is none.
std::vector<FramePose> select_frames(const FrameRange& range, const std::vector<FramePose>& frames);

/// Keeps the poses from the first to the last frame of the range, LiDAR and boxes between them, and
/// the images of its frames, so that nothing else is read later. A drive's point cloud in the axes
/// of its first frame goes with that frame, and a finding says so. UsageError if no image is left.
void keep_frames(const FrameRange& range, Recording* recording);

}  // namespace redrive
