// SPDX-License-Identifier: Apache-2.0
// Annotated objects of nuScenes: boxes at key frames, twice a second, become boxes of every frame.
#pragma once

#include <map>
#include <optional>
#include <vector>

#include "redrive/recording/core/box.h"
#include "redrive/recording/formats/nuscenes/nuscenes_scan.h"
#include "redrive/recording/formats/nuscenes/nuscenes_tables.h"

namespace redrive::nuscenes {

/// Returns the boxes of each frame by its id. An object's boxes at two key frames that are at most
/// 1.1 s apart are interpolated to the frames between them; before its first and after its last one
/// its motion continues for 0.1 s. An annotated box holds when the laser of the key frame's scan
/// points at its centre, without a LiDAR at the sample's time. Boxes are relative to `frames`.
std::map<std::int64_t, std::vector<Box>> boxes_of_frames(
    const SceneTables& scene, const std::optional<Rigid3d>& body_from_lidar, const Spin& spin,
    const std::vector<FramePose>& frames);

}  // namespace redrive::nuscenes
