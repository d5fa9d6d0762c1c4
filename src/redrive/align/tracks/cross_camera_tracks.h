// SPDX-License-Identifier: Apache-2.0
// Matches tracks across cameras of the rig: where views overlap, the patch around a point is warped
// into the other camera and searched for around its predicted position, from its depth and the
// calibration. Cameras are rigid to each other, so the matches of all frames share one relative
// pose.
#pragma once

#include <vector>

#include "redrive/align/rig/rig_images.h"
#include "redrive/align/tracks/tracks.h"

namespace redrive {

/// Adds observations by other cameras at the same frames to the tracks (*of_camera)[c] of each
/// camera. options[c]: for observations by camera c.
void match_across_cameras(const RigImages& images, const std::vector<TrackOptions>& options,
                          ThreadPool& pool, std::vector<std::vector<Track>>* of_camera);

}  // namespace redrive
