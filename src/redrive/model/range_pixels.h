// SPDX-License-Identifier: Apache-2.0
// LiDAR returns as pixels of an image.
#pragma once

#include <vector>

#include "redrive/model/model.h"

namespace redrive {

/// A LiDAR return in an image of full size.
struct RangePixel {
  int x, y;
  float log_range;  ///< logarithm of its distance from the camera, metres
};

/// Returns the LiDAR returns that a view's image shows: those of about the time of its exposure, so
/// that what moves is where it was, and not behind nearer ones.
/// Poses are those that training began with (TrainingSet::initial). Returns on moving objects are
/// where the object is by then.
std::vector<RangePixel> find_range_pixels(const TrainingSet& data, std::size_t of_view);

}  // namespace redrive
