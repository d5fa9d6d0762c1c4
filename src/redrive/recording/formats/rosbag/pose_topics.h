// SPDX-License-Identifier: Apache-2.0
// The body's poses from the topic that the rig names: tf, Odometry, poses, or fixes of a GNSS
// receiver with the orientation of an Imu.
#pragma once

#include <vector>

#include "redrive/recording/core/recording.h"
#include "redrive/recording/formats/rosbag/rig.h"

namespace redrive::rosbag {

/// Returns global_from_body by time. Sets recording->global_frame; messages that are damaged go to
/// recording->damaged. InputError without a pose.
std::vector<FramePose> read_poses(const Bag& bag, const Topic& topic, const Rig& rig,
                                  const TransformTree& tree, Recording* recording);

}  // namespace redrive::rosbag
