// SPDX-License-Identifier: Apache-2.0
// Frames of drives whose images have times instead of numbers.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "redrive/recording/core/recording.h"

namespace redrive {

struct TimedImages {
  std::string camera;
  std::int64_t offset_ns = 0;     ///< CameraCalibration::time_offset_ns
  std::vector<FrameFile> images;  ///< frame_id: time in ns, after join_frames the frame
};

/// Makes frames of the images whose times minus their cameras' offsets agree to 5 ms, numbered by
/// time. A frame has the pose at the time of its earliest image minus the offset. An image at the
/// time of another one of its camera is left out and damaged; `file` is for messages.
std::vector<FramePose> join_frames(const std::vector<FramePose>& poses,
                                   const std::filesystem::path& file,
                                   std::vector<TimedImages>* cameras,
                                   std::vector<DamagedRecord>* damaged);

/// Returns the frame that is nearest in time; `frames`: at least one.
const FramePose& nearest_frame(const std::vector<FramePose>& frames, std::int64_t t_ns);

}  // namespace redrive
