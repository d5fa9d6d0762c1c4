// SPDX-License-Identifier: Apache-2.0
// Tracks features over the images of one camera: corners (Shi, Tomasi 1994) on a grid, pyramidal
// Lucas-Kanade from the positions that the recorded poses predict, and registration with the
// track's first patch.
#pragma once

#include "redrive/align/rig/rig_images.h"
#include "redrive/align/tracks/tracks.h"
#include "redrive/base/progress.h"

namespace redrive {

/// Returns tracks with two or more observations of one camera, not yet checked by
/// drop_epipolar_outliers. `progress`: counts images.
std::vector<Track> track_features(const RigImages& images, int camera, const TrackOptions& options,
                                  Progress* progress);

}  // namespace redrive
