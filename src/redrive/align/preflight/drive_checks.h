// SPDX-License-Identifier: Apache-2.0
// Checks of a recording's own statements, which need no tracked points.
#pragma once

#include <optional>
#include <vector>

#include "redrive/align/preflight/preflight.h"
#include "redrive/image/image.h"
#include "redrive/scene/lidar/lidar_returns.h"

namespace redrive {

/// Whether each pose agrees with the motion of the frames around it (recording/core/pose_jumps.h).
SharedCheck check_motion(const Recording& recording);

/// Whether returns of the LiDAR lie in images, seen from the nearest view in time.
SharedCheck check_lidar_in_images(const Scene& scene, const LidarReturns& lidar);

/// Whether no pixel is brighter than 2 of 255.
bool is_black(const Image8& image);

/// Findings that name a camera's black images.
std::vector<Finding> find_black_images(const RigImages& images);

/// A finding where the focal length of EXIF in a camera's first image is more than 1.5 times the
/// calibrated one, or less than 1 / 1.5 of it; for perspective models.
std::optional<Finding> contradicted_focal_length(const RecordedCamera& camera);

}  // namespace redrive
