// SPDX-License-Identifier: Apache-2.0
// Objects that move within themselves, as people do. Their Gaussians are divided into parts: what
// is on the road, as a shadow, and the cells of a grid in the box. Each part has corrections of the
// track of its own (actor_motion.h), which turn it about the centre of its cell.
#pragma once

#include <cstddef>
#include <vector>

#include "redrive/model/gaussian_layout.h"
#include "redrive/scene/moving_object.h"

namespace redrive {

/// Number of parts of an articulated object.
constexpr std::size_t kArticulatedParts = 16;

/// The part in the middle of the box: it turns about the box's centre.
constexpr std::size_t kMiddlePart = 8;

/// Whether an object moves within itself: people, animals (recording/core/actor_kind.h), and what
/// nobody annotated if it is no larger than somebody on a bicycle.
bool is_articulated(const MovingObject& object);

/// Returns the Gaussians of each part, in their order. size_m: the box's.
std::vector<GaussianList> divided(const GaussianList& list, const Eigen::Vector3d& size_m);

/// Returns the point about which a part turns, in the axes of the box.
Eigen::Vector3d pivot_of(std::size_t part, const Eigen::Vector3d& size_m);

}  // namespace redrive
