// SPDX-License-Identifier: Apache-2.0
// Which observations agree with the others of their images: the static world is what most of them
// show.
#pragma once

#include "redrive/align/rig/rig_images.h"
#include "redrive/align/tracks/tracks.h"

namespace redrive {

/// Drops the observations of one camera's tracks that lie too far (options.max_epipolar_error_px)
/// from what most points do between two images, and tracks that are left with too few
/// (options.min_observations). Compared are images 1, 2 and 4 apart; their relative pose is
/// fitted to the tracks.
void drop_epipolar_outliers(const RigImages& images, const TrackOptions& options,
                            std::vector<Track>* tracks);

}  // namespace redrive
