// SPDX-License-Identifier: Apache-2.0
// First Gaussians of a moving object, in the axes of its box.
#pragma once

#include <cstdint>

#include "redrive/base/parallel.h"
#include "redrive/model/gaussian_layout.h"
#include "redrive/model/trainee.h"

namespace redrive {

/// Returns Gaussians on the LiDAR returns of all times, and on their mirror images beyond the
/// vertical plane along the object where no return is near; on few returns more at random on the
/// box; opaque ones in the core of its box (recording/core/actor_kind.h); and, for its shadow,
/// black and nearly transparent ones on the road, up to kShadow_m beside the box and `ahead_m`
/// ahead of it. A colour comes from the training image nearest in time that shows the point, or its
/// mirror image, past the object's core; else from the nearest point that an image shows, rather at
/// the same height. `voxel`: side of a voxel that keeps one point, as a part of its distance from
/// the cameras. Deterministic in key.
GaussianList actor_gaussians(const TrainingSet& data, const MovingObject& actor, float voxel,
                             float ahead_m, std::uint64_t key, ThreadPool& pool);

}  // namespace redrive
