// SPDX-License-Identifier: Apache-2.0
// The same points in other cameras of the rig: where views overlap, the surroundings of a point are
// drawn as the other camera would see them and searched for where its depth and the calibration
// have it. Cameras are rigid to each other, so the matches of all frames have one relative pose to
// agree in.
#pragma once

#include <vector>

#include "redrive/align/rig/rig_images.h"
#include "redrive/align/tracks/tracks.h"

namespace redrive {

/// Adds to tracks of each camera (*of_camera)[c] what other cameras see of them at the same frames.
/// options[c]: for what is seen by camera c.
void match_across_cameras(const RigImages& images, const std::vector<TrackOptions>& options,
                          ThreadPool& pool, std::vector<std::vector<Track>>* of_camera);

}  // namespace redrive
