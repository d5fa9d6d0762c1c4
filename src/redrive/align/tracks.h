// SPDX-License-Identifier: Apache-2.0
// Where static points of the scene are seen in a recording's images: what redrive align moves poses by.
#pragma once

#include <vector>

#include <Eigen/Core>

#include "redrive/base/parallel.h"
#include "redrive/recording/recording.h"
#include "redrive/scene/masks.h"

namespace redrive {

/// One static point in one image.
struct Observation {
  int camera = 0;         ///< index into Recording::cameras
  int frame = 0;          ///< index into Recording::frames
  Eigen::Vector2d pixel;  ///< of the image as recorded; integer coordinates are pixel centres
};

/// The same point in several images, of one camera over time or of several cameras.
struct Track {
  std::vector<Observation> seen;  ///< at least two, of different images
};

}  // namespace redrive
