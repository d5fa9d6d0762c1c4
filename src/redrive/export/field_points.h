// SPDX-License-Identifier: Apache-2.0
// Points of a trained field's surfaces.
#pragma once

#include <vector>

#include "redrive/recording/lidar/ply.h"
#include "redrive/train/run.h"

namespace redrive {

/// Returns at most `most` views that are not held out, evenly spaced; 0: all.
std::vector<const View*> training_views(const Scene& scene, std::size_t most);

/// Renders training views of a run and returns the points at their pixels' depth, in the scene's
/// world, with rendered colours and unit normals that face the camera. Pixels with less than
/// `least_opacity`, beyond far_m or without a normal have no point. Pixels are taken evenly, at
/// most `most`, from evenly chosen views, at most `max_views`.
std::vector<PlyPoint> field_points(const Run& run, kernels::Backend& backend, std::size_t most,
                                   std::size_t max_views = 100, float least_opacity = 0.9f);

}  // namespace redrive
