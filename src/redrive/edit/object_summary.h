// SPDX-License-Identifier: Apache-2.0
// Summary of each annotated object of a recording.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "redrive/scene/moving_objects.h"

namespace redrive {

struct ObjectSummary {
  std::int64_t id = 0;
  std::string type;
  bool moves = false;  ///< as MovingObjects has it
  std::size_t boxes = 0;
  double driven_m = 0;     ///< length of the straight lines from each of its boxes to the next
  double nearest_m = 0;    ///< least distance of its centre from the ego vehicle's origin
  std::size_t images = 0;  ///< images that show its centre, unless something hides it
};

/// Returns summaries in the order of ids; `images` counts the scene's images.
std::vector<ObjectSummary> summarize_objects(const Scene& scene, const MovingObjects& objects);

}  // namespace redrive
