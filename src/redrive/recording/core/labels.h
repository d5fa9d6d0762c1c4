// SPDX-License-Identifier: Apache-2.0
// Annotated objects as formats store them, an entry for each object and frame, and the boxes that
// they become.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include "redrive/recording/core/box.h"
#include "redrive/recording/core/recording.h"

namespace redrive {

/// An object in one frame, in the axes of the sensor in which it is annotated.
struct Label {
  std::int64_t frame_id = 0, object_id = 0;
  std::string type;         ///< "Car", "Pedestrian", ...
  Rigid3d sensor_from_box;  ///< axes and origin of the box as in Box
  Eigen::Vector3d size_m = Eigen::Vector3d::Zero();
};

/// Returns the time at which a label of a frame holds, on the frame's clock.
using TimeOfLabel = std::function<std::int64_t(const Label& label, const FramePose& frame)>;

/// Returns the boxes of the frames that have a pose, keyed by frame. Each holds at its `time_of`;
/// nullptr: at its frame's time. Velocities are least-squares slopes of the positions within half a
/// second. `frames`: at least one, with increasing ids and times.
std::map<std::int64_t, std::vector<Box>> place_boxes(const std::vector<Label>& labels,
                                                     const Rigid3d& body_from_sensor,
                                                     const std::vector<FramePose>& frames,
                                                     const TimeOfLabel& time_of = nullptr);

}  // namespace redrive
