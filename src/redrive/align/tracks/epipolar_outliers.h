// SPDX-License-Identifier: Apache-2.0
// Rejects observations that do not agree with the epipolar geometry of most points of their images,
// which belong to the static world.
#pragma once

#include "redrive/align/rig/rig_images.h"
#include "redrive/align/tracks/tracks.h"

namespace redrive {

/// Drops observations of one camera's tracks with an epipolar error above
/// options.max_epipolar_error_px, and tracks with fewer than options.min_observations left.
/// Compares images 1, 2 and 4 apart; their relative pose is fitted to the tracks.
void drop_epipolar_outliers(const RigImages& images, const TrackOptions& options,
                            std::vector<Track>* tracks);

}  // namespace redrive
