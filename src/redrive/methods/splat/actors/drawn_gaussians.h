// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "redrive/base/buffer.h"
#include "redrive/kernels/gaussian/gaussian_stages.h"
#include "redrive/model/rendered_image.h"
#include "redrive/scene/shutter_poses.h"

namespace redrive {

/// Gaussians that a raster draws, in the world and on the moving objects that a sensor sees.
struct DrawnGaussians {
  kernels::Gaussians gaussians;
  std::vector<kernels::GaussianPart> parts;  ///< refer to `actors` and `poses`
  std::vector<ShutterPoses::Actor> actors;
  std::vector<std::vector<PlainPose>> poses = {};  ///< poses of parts of articulated objects
  std::vector<int> numbers = {};  ///< ShutterPoses::Actor::number by object; 0: not drawn
  Buffer<float> copied = {};      ///< the numbers, where a body is shown twice or recoloured
};

/// Returns the objects of a labelled image, by ShutterPoses::Actor::number.
std::vector<SeenActor> seen_actors_of(const kernels::RasterImage& image,
                                      const DrawnGaussians& shown);

}  // namespace redrive
