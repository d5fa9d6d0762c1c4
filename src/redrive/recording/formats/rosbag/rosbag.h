// SPDX-License-Identifier: Apache-2.0
// Bags of ROS 2, the folder of a bag: .mcap or .db3 files with metadata.yaml, and rig.yaml (rig.h),
// which maps topics to sensors.
#pragma once

#include <filesystem>

#include "redrive/recording/core/recording.h"
#include "redrive/recording/formats/mapping.h"

namespace redrive::rosbag {

bool looks_like(const std::filesystem::path& root);
/// Reads the heads of images and scans and all poses; images and scans are read in the bag when
/// they are asked for. InputError where the bag leaves the mapping open and has no rig.yaml.
Recording open(const std::filesystem::path& root, PoseSource source);
Mapping mapping(const std::filesystem::path& root);

}  // namespace redrive::rosbag
