// SPDX-License-Identifier: Apache-2.0
// Points of a trained field's surfaces.
#pragma once

#include <vector>

#include "redrive/recording/ply.h"
#include "redrive/train/run.h"

namespace redrive {

/// Renders training views of a run and returns the points of their pixels' depth, in the scene's
/// world, with rendered colours and unit normals that face the camera. Pixels with less than
/// `least_opacity`, beyond far_m or without a normal have no point. Pixels are taken evenly, so
/// that at most `most` points come out. Views are taken evenly, at most `max_views`.
std::vector<PlyPoint> field_points(const Run& run, kernels::Backend& backend, std::size_t most,
                                   int max_views = 100, float least_opacity = 0.9f);

}  // namespace redrive
